"""What comes from the process that reads a board, and the packet numbers in it."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import struct
import subprocess
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import GatewayError, ProtocolError, ProtocolReason, TransportError
from biosensor_gateway.devices.brainflow import board_spec, board_streams
from biosensor_gateway.devices.brainflow import driver as process_module
from biosensor_gateway.devices.brainflow.driver import DRIVER, BrainFlowSettings
from biosensor_gateway.devices.brainflow.driver.emitter import (
    Frames,
    PresetEmitter,
    Rows,
    SampleCount,
    Told,
)
from tests.brainflow.conftest import ENVIRONMENT, BoardRun, board_settings
from tests.rigs.driver_run import NotedSink, supervised
from tests.rigs.emitter_sink import EmitterSink
from tests.rigs.polling import until

# What comes from the process that reads a board, in any pieces, and when it is none of it.


def frame(kind: bytes, preset: int, content: bytes) -> bytes:
    return kind + struct.pack("<BI", preset, len(content)) + content


VALUES = np.arange(12.0).reshape(3, 4)
SENT = (
    frame(b"J", 0, b'{"started": true}')
    + frame(b"S", 1, struct.pack("<dI", 1.5, 3) + VALUES.tobytes())
    + frame(b"B", 0, b"")
)


@given(st.lists(st.integers(1, len(SENT) - 1), max_size=20))
def test_any_pieces_give_the_same(cuts: list[int]) -> None:
    edges = [0, *sorted(cuts), len(SENT)]
    frames = Frames()
    found = [each for begin, end in pairwise(edges) for each in frames.feed(SENT[begin:end])]
    started, rows, beat = found
    assert (started, beat) == (Told({"started": True}), Told({}))
    assert isinstance(rows, Rows)
    assert (rows.preset, rows.now_s) == (1, 1.5)
    np.testing.assert_array_equal(rows.values, VALUES)


@given(st.binary(max_size=200))
def test_no_bytes_are_anything_but_frames_or_one_reason(data: bytes) -> None:
    try:
        list(Frames().feed(data))
    except ProtocolError as error:
        assert error.reason is ProtocolReason.GARBAGE


@pytest.mark.parametrize(
    "bad",
    [
        b"Traceback (most recent call last)",
        frame(b"J", 0, b"[1]"),
        frame(b"J", 0, b"not json"),
        frame(b"S", 0, struct.pack("<dI", 1.0, 0)),
        frame(b"S", 0, struct.pack("<dI", 1.0, 5) + bytes(8)),
        frame(b"S", 0, b"short"),
    ],
)
def test_what_is_no_frame_is_said(bad: bytes) -> None:
    with pytest.raises(ProtocolError, match="restarted"):
        list(Frames().feed(bad))


# Packet numbers of boards that count, and of those that do not.
@given(
    turn=st.sampled_from([201, 256]),
    first=st.integers(0, 200),
    lost=st.sets(st.integers(1, 998)),
    cuts=st.lists(st.integers(1, 60), min_size=30, max_size=60),
)
def test_what_is_missing_is_counted_and_keeps_its_place(
    turn: int, first: int, lost: set[int], cuts: list[int]
) -> None:
    kept = np.array([place for place in range(1000) if place not in lost])
    # More than a turn in a row cannot be seen in the number.
    if np.diff(kept).max() >= turn:
        return
    count = SampleCount(turn)
    places: list[int] = []
    missing = 0
    begin = 0
    for cut in [*cuts, 1000]:
        part = kept[begin : begin + cut]
        begin += cut
        if len(part):
            found, gone = count.place(((first + part) % turn).astype(np.float64))
            places += found.tolist()
            missing += gone
    assert places == kept.tolist()
    assert missing == 1000 - len(kept) - (999 - kept[-1])


@pytest.mark.parametrize("numbers", [[5.0, 5.0, 5.0, 5.0], [9.0, 1.0, 700.0, 3.0]])
def test_a_board_that_counts_nothing_loses_nothing(numbers: list[float]) -> None:
    places, missing = SampleCount(0).place(np.array(numbers))
    assert places.tolist() == [0, 1, 2, 3]
    assert missing == 0


@pytest.mark.parametrize(("true_hz", "is_said"), [(200.0, True), (251.0, False)])
def test_another_rate_than_the_declared_one_is_shown_and_not_only_logged(
    true_hz: float, is_said: bool
) -> None:
    sink = EmitterSink("polar_h10")
    where = {"timestamp_channel": 0, "package_num_channel": 1, "num_rows": 2}
    emitter = PresetEmitter((), where, 250.0, 256, sink, sink)
    for second in range(25):
        numbers = np.arange(second * true_hz, (second + 1) * true_hz)
        values = np.stack([numbers / true_hz, numbers % 256])
        emitter.take(Rows(0, float(values[0, -1]), values), 1000 + float(values[0, -1]))
    said = [*sink.watch.remarks.values()]
    assert any("200.0 samples per second but 250 are declared" in each for each in said) == is_said


# Boards of an unmodified BrainFlow, in a process of its own, under the supervisor.


RATE_HZ = 250.0
# A Python that imports BrainFlow takes its time to start on a busy machine.
START_LIMIT_S = 60.0
DESCRIBE_ALL = """
import json, warnings
warnings.simplefilter("ignore")
from brainflow.board_shim import BoardIds, BoardShim
found = {}
for board in BoardIds:
    try:
        presets = BoardShim.get_board_presets(board.value)
        found[board.name] = {each: BoardShim.get_board_descr(board.value, each) for each in presets}
    except Exception:
        pass
print(json.dumps(found))
"""


async def until_started(condition: Callable[[], object]) -> None:
    now = asyncio.get_running_loop().time
    deadline = now() + START_LIMIT_S
    while not condition():
        assert now() < deadline, "it did not start"
        await asyncio.sleep(0.02)


@pytest.mark.nightly
async def test_the_synthetic_board_streams_what_it_describes_without_a_gap() -> None:
    async with supervised(BoardRun()) as run:
        await until(run.sink.has(1000, "eeg", "acc_aux"))
    sink = run.sink
    assert sink.spec.stream("eeg").labels[:3] == ("Fz", "C3", "Cz")
    assert sink.spec.stream("acc").labels == ("X", "Y", "Z")
    assert {name for name in sink.rows if sink.rows[name]} >= {"eeg", "gsr", "ppg", "temp", "bat"}
    assert run.lost == {}
    for name in ("eeg", "acc_aux"):
        spacing_s = np.diff(sink.times[name][250:])
        assert abs(np.median(spacing_s) - 1 / RATE_HZ) < 1e-4
        assert np.sqrt(np.mean((spacing_s - np.median(spacing_s)) ** 2)) < 1e-3
    assert sink.times["eeg"] == sink.times["gsr"]


@pytest.mark.nightly
async def test_electrodes_are_on_what_the_settings_say() -> None:
    async with supervised(BoardRun(electrodes="ecg")) as run:
        await until(run.sink.has(10, "ecg"))
    assert "eeg" not in run.sink.rows
    assert run.sink.spec.stream("ecg").labels[0] == "ECG1"


@pytest.mark.nightly
async def test_a_recording_of_brainflow_is_played_value_by_value(tmp_path: Path) -> None:
    rows, count = 24, 300
    values = np.zeros((rows, count))
    values[0] = np.arange(count) % 256
    values[1:9] = np.round(np.random.default_rng(3).normal(0, 100, (8, count)), 3)
    values[22] = 1.7e9 + np.arange(count) / RATE_HZ
    file = tmp_path / "recording.csv"
    np.savetxt(file, values.T, fmt="%.6f", delimiter="\t")
    fields = {"board": "PLAYBACK_FILE_BOARD", "master_board": "CYTON_BOARD", "file": str(file)}
    async with supervised(BoardRun(**fields, name="played")) as run:
        await until(run.sink.has(count - 60, "eeg"))
    played = run.sink.array("eeg")
    sent = values[1:9].T.astype(np.float32)
    np.testing.assert_allclose(played, sent[: len(played)], rtol=0, atol=1e-3)


@pytest.mark.nightly
async def test_a_process_that_is_killed_or_hangs_is_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    started: list[subprocess.Popen[bytes]] = []
    real = process_module.start

    def noted(settings: BrainFlowSettings, command: str) -> subprocess.Popen[bytes]:
        process = real(settings, command)
        # Those that describe a board end by themselves.
        if command == "stream":
            started.append(process)
        return process

    monkeypatch.setattr(process_module, "start", noted)
    async with supervised(BoardRun()) as run:
        for number, act in enumerate((signal.SIGKILL, signal.SIGSTOP), start=1):
            await until_started(lambda number=number: run.supervisor.connections == number)
            await run.goes_on(50, "eeg")
            os.kill(started[-1].pid, act)
        await until_started(lambda: run.supervisor.connections == 3)
        await run.goes_on(50, "eeg")
    assert [process.poll() is not None for process in started] == [True] * 3


@pytest.mark.nightly
async def test_no_process_outlives_an_agent_that_is_killed(tmp_path: Path) -> None:
    noted = tmp_path / "pid"
    program = (
        "import os, sys, time\n"
        "from tests.brainflow.conftest import board_settings\n"
        "from biosensor_gateway.devices.brainflow.driver import _order, start\n"
        "settings = board_settings()\n"
        "process = start(settings, 'stream')\n"
        "process.stdin.write(_order(settings, (0,)))\n"
        "process.stdin.flush()\n"
        "process.stdout.read(100)\n"
        f"open({str(noted)!r}, 'w').write(str(process.pid))\n"
        "os.kill(os.getpid(), 9)\n"
    )
    root = Path(__file__).parents[2]
    agent = await asyncio.create_subprocess_exec(
        root / ".venv" / "bin" / "python", "-c", program, cwd=root
    )
    await agent.wait()
    await until(lambda: _has_ended(Path("/proc", noted.read_text(), "stat")))


def _has_ended(process: Path) -> bool:
    try:
        state = process.read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    # Who inherits it may be slow to take note.
    return state == "Z"


@pytest.mark.nightly
class TestOneSentenceSays:
    async def _refused(self, **fields: str) -> GatewayError:
        settings = board_settings(**fields)
        assert DRIVER.declare is not None
        sink = NotedSink(settings.sensor_name, spec=DRIVER.declare(settings))
        driver = DRIVER.make(settings, sink)()
        try:
            with pytest.raises((TransportError, ProtocolError)) as caught:
                await driver.connect()
        finally:
            await driver.close()
        assert "\n" not in str(caught.value)
        return caught.value

    async def test_that_a_python_has_no_brainflow(self) -> None:
        own = ENVIRONMENT.parent / ".venv" / "bin" / "python"
        said = str(await self._refused(python=str(own)))
        assert "pip install biosensor-gateway[brainflow]" in said

    async def test_that_there_is_no_such_python(self) -> None:
        assert "is python right?" in str(await self._refused(python="/nowhere/python"))

    async def test_that_a_python_has_no_full_path(self) -> None:
        assert "not a full path" in str(await self._refused(python="python3"))

    async def test_that_there_is_no_such_board(self) -> None:
        assert "there is no board CYTOM_BOARD" in str(await self._refused(board="CYTOM_BOARD"))

    async def test_that_brainflow_does_not_get_the_board(self) -> None:
        said = str(await self._refused(board="CYTON_BOARD", serial_port="/dev/nothing"))
        assert said.startswith("BrainFlow cannot open CYTON_BOARD: UNABLE_TO_OPEN_PORT_ERROR")

    async def test_that_the_rate_is_another(self) -> None:
        async with supervised(BoardRun(rate_hz=100.0)) as run:
            await until_started(lambda: "declared" in str(run.supervisor.last_error))
            assert run.supervisor.connections == 1
            said = str(run.supervisor.last_error)
        told = re.search(r"sends ([\d.]+) samples per second", said)
        assert told is not None
        assert float(told[1]) == pytest.approx(RATE_HZ, rel=0.05)


@pytest.mark.nightly
def test_every_board_of_brainflow_is_declared() -> None:
    board_settings()
    python = ENVIRONMENT / "bin" / "python"
    output = subprocess.run(
        [python, "-c", DESCRIBE_ALL], check=True, capture_output=True, text=True, timeout=60
    ).stdout
    found = json.loads(output[output.index("{") :])
    assert len(found) > 50
    for board, presets in found.items():
        described = {int(preset): text for preset, text in presets.items() if "num_rows" in text}
        streams = board_streams(described)
        spec = board_spec(board_settings(board=board).sensor_name, board, streams)
        assert len({stream.data_name for stream in spec.streams}) == len(spec.streams)
        for stream in streams:
            assert max(stream.rows) < described[stream.preset]["num_rows"]
