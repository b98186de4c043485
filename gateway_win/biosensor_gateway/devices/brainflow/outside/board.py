"""Read one board with BrainFlow and pass on its data; run by a Python that has BrainFlow.

    python board.py describe   print the description of each preset of a board as JSON python
    board.py stream     send its rows until the standard input ends

The job is one line of JSON on the standard input: ``board``, ``parameters`` (fields of BrainFlow's
``BrainFlowInputParams``), ``config`` (configuration texts for the board).

``stream`` writes frames: a byte for the kind, a byte for the preset, and the number of following
bytes as 32 bits, little-endian. ``J`` is JSON: ``{"started": ...}`` or ``{"error": ...}``. ``S``
are samples: Unix time in seconds, the number of rows, then all values row by row, each as a
float64. ``B`` is empty and sent every second as a keep-alive. Only the standard library and
BrainFlow are used, because nothing else may be installed where this file runs.
"""

from __future__ import annotations

import importlib
import json
import os
import struct
import sys
import threading
import time
import warnings
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

POLL_S = 0.02
BEAT_S = 1.0
FAREWELL_S = 2.0
"""Time limit for releasing the board; after that the process exits anyway."""
MISSING, FAILED = "missing", "failed"


def main() -> int:
    """Run the command in the arguments; return the exit code."""
    # Board libraries print to stdout, so frames go to a copy of it and stdout is redirected.
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    told = json.loads(sys.stdin.readline())
    warnings.simplefilter("ignore")
    try:
        shim = importlib.import_module("brainflow.board_shim")
    except (ImportError, OSError) as error:
        return _end(output, MISSING, error)
    try:
        if sys.argv[1] == "describe":
            output.write(json.dumps(_described(shim, told)).encode())
            output.close()
        else:
            _stream(shim, told, output)
    except Exception as error:  # noqa: BLE001 - whatever a board's library raises is one sentence
        return _end(output, FAILED, error)
    return 0


def _end(output: BinaryIO, reason: str, error: Exception) -> int:
    said = json.dumps({"error": reason, "said": str(error) or repr(error)}).encode()
    if sys.argv[1] == "describe":
        output.write(said)
    else:
        _frame(output, b"J", 0, said)
    output.close()
    return 1


def _number(shim: ModuleType, board: str) -> int:
    numbers = {each.name: each.value for each in shim.BoardIds}
    if board not in numbers:
        raise ValueError(f"there is no board {board}")
    return numbers[board]


def _described(shim: ModuleType, told: dict[str, Any]) -> dict[str, Any]:
    """Return the descriptions by preset; for playback, those of the recorded board."""
    board = _number(shim, told["parameters"].get("master_board") or told["board"])
    presets = shim.BoardShim.get_board_presets(board)
    found = {str(each): shim.BoardShim.get_board_descr(board, each) for each in presets}
    return {"presets": {each: text for each, text in found.items() if "num_rows" in text}}


def _stream(shim: ModuleType, told: dict[str, Any], output: BinaryIO) -> None:
    parameters = shim.BrainFlowInputParams()
    for name, value in told["parameters"].items():
        if name == "master_board":
            parameters.master_board = _number(shim, value)
        else:
            setattr(parameters, name, value)
    shim.BoardShim.disable_board_logger()
    board = shim.BoardShim(_number(shim, told["board"]), parameters)
    ended = threading.Event()
    threading.Thread(target=_wait_for_the_end, args=(ended,), daemon=True).start()
    board.prepare_session()
    try:
        for text in told["config"]:
            board.config_board(text)
        board.start_stream()
        _frame(output, b"J", 0, b'{"started": true}')

        def read(preset: int) -> NDArray[np.float64]:
            return board.get_board_data(preset=preset)

        _hand_on(read, [int(each) for each in told["presets"]], output, ended)
    finally:
        board.release_session()


def _hand_on(
    read: Callable[[int], NDArray[np.float64]],
    presets: list[int],
    output: BinaryIO,
    ended: threading.Event,
) -> None:
    beat_s = time.monotonic()
    while not ended.wait(POLL_S):
        for preset in presets:
            rows = read(preset)
            now_s = time.time()
            if rows.shape[1]:
                head = struct.pack("<dI", now_s, len(rows))
                _frame(output, b"S", preset, head + rows.astype("<f8").tobytes())
        if time.monotonic() - beat_s >= BEAT_S:
            beat_s = time.monotonic()
            _frame(output, b"B", 0, b"")


def _frame(output: BinaryIO, kind: bytes, preset: int, data: bytes) -> None:
    output.write(kind + struct.pack("<BI", preset, len(data)) + data)
    output.flush()


def _wait_for_the_end(ended: threading.Event) -> None:
    """Wait until the agent ends, which closes its end of the pipe."""
    sys.stdin.read()
    ended.set()
    time.sleep(FAREWELL_S)
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
