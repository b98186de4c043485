"""LabRecorder on a computer of its own.

    python -m tests.rigs.windows.recorder

Steered: ``start`` records the streams of ``source_ids`` into a file of ``folder`` and
answers with its path when all are open; ``stop`` ends the file; ``clocks`` tells this
computer's clocks.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tests.rigs.hosts.programs import Dialogue
from tests.rigs.windows.clocks import read_clocks
from tests.system import lab_recorder

PERIOD_S = 0.02


def _start(running: ExitStack, folder: Path, source_ids: Sequence[str]) -> str:
    path = folder / "recording.xdf"
    running.enter_context(lab_recorder.recording(path, source_ids))
    return str(path)


def main() -> None:
    with ExitStack() as running:

        def obey(command: Mapping[str, Any]) -> Any:
            match command["do"]:
                case "start":
                    return _start(running, Path(command["folder"]), command["source_ids"])
                case "stop":
                    running.close()
                case "clocks":
                    return read_clocks()._asdict()
                case other:
                    raise ValueError(f"what is {other!r}?")
            return None

        dialogue = Dialogue()
        while not dialogue.ended:
            dialogue.answer(obey)
            time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()
