"""The system clock is stepped by an hour, forward and back, for some processes only."""

from __future__ import annotations

import mmap
import os
import struct
import time
from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.faults.agent import AgentProcess
from tests.faults.recorder import Recorded, Recorder
from tests.faults.scenarios.figures import Record
from tests.faults.scenarios.one_computer import ThisMachine
from tests.rigs.compiler import compile_c
from tests.rigs.hosts import completeness
from tests.rigs.hosts.completeness import Recording
from tests.rigs.hosts.programs import Program, SteeredProgram

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

# The system clock is stepped by an hour, forward and back, under the agent and the node.

FAULT = "system clock stepped by +1 h, then -1 h"
HOUR_NS = 3600 * 1_000_000_000
OFFSETS_NS = (0, HOUR_NS, 0)
# The node measures the clock once a second, a busy one seconds later.
NOTICED_S = 6.0
STEADY_S = 3.0
LIMIT_S = 0.002
DEADLINE_S = 60.0
SENSOR = "zephyr"
ECG, ECG_PERIOD_S = "zephyr-virtual-ecg", 0.004
STAMPED = "/biosensors/empatica_e4/st_temperature"


class Phase(NamedTuple):
    """Between two steps: Unix time at its begin, and what the clock is ahead in it."""

    begin_ns: int
    offset_ns: int


class Stepped(NamedTuple):
    """What came of it."""

    phases: list[Phase]
    # stamped, true_ns: what the subscriber got, and when each numbered sample was sent.
    stamped: Recording
    true_ns: NDArray[np.int64]
    node_log: str
    # ecg, reanchors, lost: of the agent: its samples, and what its status says at the end.
    ecg: Recorded
    reanchors: int
    lost: int

    def errors_s(self, phase: int) -> NDArray[np.float64]:
        """Stamp errors of the samples sent in a phase."""
        _, errors_s = self._of(phase)
        return errors_s

    def noticed(self, phase: int) -> tuple[float, NDArray[np.float64]]:
        """When stamps follow the new clock, in seconds from the step, and the errors from then."""
        sent_s, errors_s = self._of(phase)
        is_new = np.abs(errors_s) < HOUR_NS / 2e9
        assert is_new.any(), "no stamp follows the step"
        first = int(is_new.argmax())
        return float(sent_s[first]), errors_s[first:]

    def _of(self, phase: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """When each sample of a phase was sent, in seconds from its begin, and its error."""
        begin_ns, offset_ns = self.phases[phase]
        ends_ns = [each.begin_ns for each in self.phases[1:]] + [2**62]
        sent_ns = self.true_ns[self.stamped.rows[:, 0].astype(int)]
        chosen = (sent_ns >= begin_ns) & (sent_ns < ends_ns[phase])
        errors_ns = self.stamped.stamps[chosen] - sent_ns[chosen] - offset_ns
        return (sent_ns[chosen] - begin_ns) / 1e9, errors_ns / 1e9


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> Generator[Stepped]:
    folder = tmp_path_factory.mktemp("stepped")
    here = ThisMachine()
    with (
        SteppedClock(folder) as clock,
        SteeredProgram(here, os.environ, folder, "tests.rigs.hosts.subscriber") as subscriber,
        SteeredProgram(here, os.environ, folder, "tests.rigs.hosts.sender") as sender,
        Program(here, {**os.environ, **clock.environment}, folder, "lsl_to_ros.node") as node,
        AgentProcess(folder, "--simulate", SENSOR, environment=clock.environment) as agent,
        Recorder({ECG: 1}) as recorder,
    ):
        _await_samples(agent, subscriber, recorder)
        phases = [_step(clock, offset_ns) for offset_ns in OFFSETS_NS]
        status = agent.devices()[SENSOR]
        yield Stepped(
            phases,
            _stamped(subscriber, folder),
            np.array(sender.ask("sent")),
            node.log,
            recorder.recorded(ECG),
            status["clock"]["reanchors"],
            sum(each["lost"] for each in status["streams"].values()),
        )


def _await_samples(agent: AgentProcess, subscriber: SteeredProgram, recorder: Recorder) -> None:
    end = time.monotonic() + DEADLINE_S
    while not recorder.newest(ECG) or not subscriber.ask("state")["received"].get(STAMPED):
        assert agent.is_running, agent.console()
        assert time.monotonic() < end, "nothing flows"
        time.sleep(0.2)


def _step(clock: SteppedClock, offset_ns: int) -> Phase:
    begin_ns = time.time_ns()
    clock.set_offset(offset_ns)
    time.sleep(NOTICED_S + STEADY_S)
    return Phase(begin_ns, offset_ns)


def _stamped(subscriber: SteeredProgram, folder: Path) -> Recording:
    path = folder / "topics.npz"
    subscriber.ask("save", path=str(path))
    return completeness.load(path)[STAMPED]


@pytest.mark.parametrize("phase", [1, 2], ids=["forward", "back"])
def test_the_stamps_follow_the_clock(stepped: Stepped, figures: Record, phase: int) -> None:
    noticed_s, errors_s = stepped.noticed(phase)
    worst_s = float(np.abs(errors_s).max())
    what = f"ROS stamp error, steady after the step {'forward' if phase == 1 else 'back'}"
    figures(FAULT, what, "≤ 2 ms", f"{1000 * worst_s:.3f} ms, from {noticed_s:.1f} s on")
    assert noticed_s <= NOTICED_S
    assert len(errors_s) > STEADY_S
    assert worst_s <= LIMIT_S


def test_before_the_step_the_stamps_are_true(stepped: Stepped) -> None:
    assert np.abs(stepped.errors_s(0)).max() <= LIMIT_S


def test_the_clock_of_the_node_was_stepped(stepped: Stepped) -> None:
    """Between step and report the stamps are an hour off, or nothing was stepped."""
    errors_s = stepped.errors_s(1)
    is_off = np.abs(errors_s) > LIMIT_S
    np.testing.assert_allclose(errors_s[is_off], -HOUR_NS / 1e9, atol=LIMIT_S)
    assert is_off.any() or "jumped" in stepped.node_log


def test_each_step_is_reported_once(stepped: Stepped, figures: Record) -> None:
    said = [line for line in stepped.node_log.splitlines() if "the system clock jumped" in line]
    figures(FAULT, "reports of the node, for two steps", "2", str(len(said)))
    sizes_s = [float(line.partition("jumped by ")[2].split()[0]) for line in said]
    np.testing.assert_allclose(sizes_s, [3600.0, -3600.0], atol=LIMIT_S)


def test_no_message_is_lost_at_a_step(stepped: Stepped) -> None:
    assert (np.diff(stepped.stamped.rows[:, 0]) == 1).all()


def test_the_lsl_stamps_go_on_evenly(stepped: Stepped, figures: Record) -> None:
    spacing_s = np.diff(stepped.ecg.times)
    worst_s = float(np.abs(spacing_s - ECG_PERIOD_S).max())
    figures(FAULT, "LSL stamps, worst spacing error", "monotone", f"{1000 * worst_s:.3f} ms")
    assert (spacing_s > 0).all()
    assert worst_s < ECG_PERIOD_S
    assert (stepped.reanchors, stepped.lost) == (0, 0)


# A system clock that is stepped for some processes only; see ``stepped_clock.c``.
SOURCE = Path(__file__).with_name("stepped_clock.c")
_OFFSET = struct.Struct("=q")


class SteppedClock:
    """The clock of all processes that get its environment; a context manager.

    Parameters
    ----------
    folder
        Gets the library and the file that it reads the offset from.

    Raises
    ------
    CompilerError
        If there is no C compiler, or it fails.
    """

    def __init__(self, folder: Path) -> None:
        library, self._file = folder / "stepped_clock.so", folder / "offset"
        compile_c(SOURCE, library, "-shared", "-fPIC", "-ldl")
        self._file.write_bytes(_OFFSET.pack(0))
        self._opened = self._file.open("r+b")
        self._page = mmap.mmap(self._opened.fileno(), _OFFSET.size)
        self.environment = {"LD_PRELOAD": str(library), "STEPPED_CLOCK": str(self._file)}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._page.close()
        self._opened.close()

    def set_offset(self, offset_ns: int) -> None:
        """Let the clock be so much ahead of the true one from now on."""
        # Eight aligned bytes are written at once.
        self._page[:] = _OFFSET.pack(offset_ns)
