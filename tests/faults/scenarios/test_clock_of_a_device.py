"""Clocks of devices drift, turn midnight, roll over and jump, while an agent streams.

A BioHarness whose oscillator is 200 ppm slow has its clock set; a Shimmer whose oscillator is
200 ppm fast rolls its 24 bits of ticks over. Both send over pseudo-terminals, with delays
of a radio, and know when each of their samples was measured.
"""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from datetime import date
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from pylsl import local_clock

from biosensor_gateway.devices.shimmer3_gsr.simulator import SimulatedShimmer3
from biosensor_gateway.devices.zephyr.simulator.bioharness import Outgoing
from biosensor_gateway.devices.zephyr.simulator.wire import DeviceStamp, Packet
from biosensor_gateway.devices.zephyr.simulator.zephyr import SyntheticSource
from biosensor_gateway.simulation.world import World
from tests.faults.agent import AgentProcess
from tests.faults.expectations import source, unit_of
from tests.faults.matching import match
from tests.faults.recorder import Recorded, Recorder
from tests.faults.scenarios.figures import Record
from tests.faults.scenarios.stage import wait_until
from tests.rigs.lab_client import Samples
from tests.rigs.processes import before_others
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = [pytest.mark.alone, pytest.mark.timeout(180)]

SHIMMER, ZEPHYR = "shimmer3_gsr", "zephyr"
STREAMS = {SHIMMER: "gsr", ZEPHYR: "ecg"}
DRIFT_PPM = {SHIMMER: 200.0, ZEPHYR: -200.0}
JITTER_S = 0.01
TICKS_PER_S, TICKS = 32_768, 1 << 24
SETTLE_S = 10.0
FAULTS = {
    SHIMMER: "device clock +200 ppm, 24 bits roll over",
    ZEPHYR: "device clock -200 ppm, midnight, jumps of ±1 h",
}
# Counted from power-on; by then the agent knows the clocks.
TURN_S, TURNED_S = 18.0, 20.0
MIDNIGHT = DeviceStamp(date(2026, 3, 31), 24 * 3_600_000 - round(1000 * TURN_S))
EACH_S = 6.0
# Of a clock that has jumped, one packet tells at first, with whatever delayed it; what better
# ones tell takes a second to count for two thirds.
ANCHORED_S = 3.0
# What is measured so long before a jump may be in a packet that is stamped behind it.
PACKET_S = 0.5
JUMPS_S = (3600.0, -3600.0)
# With what of the radio's delay nobody can know.
LIMIT_S = 0.020
LIMIT_RMS_S = 0.003
DEADLINE_S = 60.0


class Errors(NamedTuple):
    """Before the first jump, about each, and from `ANCHORED_S` behind each on."""

    steady_s: NDArray[np.float64]
    jumped_s: NDArray[np.float64]
    later_s: NDArray[np.float64]


class Observed(NamedTuple):
    """What came of it."""

    # received, truth: by sensor, one stream each.
    received: Mapping[str, Recorded]
    truth: Mapping[str, Samples]
    # LSL time of each jump of the BioHarness, and how often it was re-anchored once it was.
    jumps: Sequence[tuple[float, int]]
    reanchors: int  # Of the BioHarness when both clocks had turned.
    status: Mapping[str, Any]  # Of the agent at the end, by sensor.
    log: Sequence[Mapping[str, Any]]  # Everything that it said.

    def errors_s(self, name: str) -> Errors:
        """Stamp minus true time, from the tenth second on."""
        received, truth = self.received[name], self.truth[name]
        true_s = truth.times[match(received, truth)]
        errors_s = received.times - true_s
        since_s = np.full(len(true_s), -np.inf)
        for jumped_s, _ in self.jumps:
            is_behind = true_s >= jumped_s - PACKET_S
            since_s[is_behind] = true_s[is_behind] - jumped_s
        is_steady = (true_s >= truth.times[0] + SETTLE_S) & np.isneginf(since_s)
        is_anchored = since_s >= ANCHORED_S
        is_jumped = np.isfinite(since_s) & ~is_anchored
        return Errors(errors_s[is_steady], errors_s[is_jumped], errors_s[is_anchored])


@pytest.fixture(scope="module")
def observed(tmp_path_factory: pytest.TempPathFactory) -> Observed:
    folder = tmp_path_factory.mktemp("device-clocks")
    body = SyntheticSource(clock_start=MIDNIGHT, drift_ppm=DRIFT_PPM[ZEPHYR], jitter_s=JITTER_S)
    with ExitStack() as stack:
        # The devices are in this process, which starts the agent.
        stack.enter_context(_before_others())
        world = stack.enter_context(World())
        zephyr = stack.enter_context(SteeredBioHarness(body))
        shimmer = stack.enter_context(
            SimulatedShimmer3(
                world,
                first_tick=TICKS - round(TURN_S * TICKS_PER_S),
                drift_ppm=DRIFT_PPM[SHIMMER],
                jitter_s=JITTER_S,
            )
        )
        turned_s = time.monotonic() + TURNED_S
        ports = {SHIMMER: str(shimmer.settings["port"]), ZEPHYR: zephyr.port}
        agent = stack.enter_context(_agent(folder, ports))
        sources = {name: source(name, data_name) for name, data_name in STREAMS.items()}
        recorder = stack.enter_context(Recorder(dict.fromkeys(sources.values(), 1)))
        _await_streams(agent, recorder, sources.values())
        assert time.monotonic() < turned_s - (TURNED_S - TURN_S), "they turned unwatched"
        time.sleep(max(0.0, turned_s - time.monotonic()))
        reanchors = _reanchors(agent)
        jumps = list(_jump(zephyr, agent))
        return Observed(
            {name: recorder.recorded(each) for name, each in sources.items()},
            {
                SHIMMER: Samples(*shimmer.truth.samples(STREAMS[SHIMMER])),
                ZEPHYR: _ecg(zephyr.sent),
            },
            jumps,
            reanchors,
            agent.devices(),
            agent.log(),
        )


@contextmanager
def _before_others() -> Generator[None]:
    """Let this thread, and all threads and programs that it starts, run before others."""
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    before_others()
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, usual)


def _agent(folder: Path, ports: Mapping[str, str]) -> AgentProcess:
    settings = folder / "settings.toml"
    settings.write_text(
        "".join(
            f'[[device]]\nsensor = "{name}"\nunit = "{unit_of(name)}"\nport = "{port}"\n'
            for name, port in ports.items()
        )
    )
    return AgentProcess(folder, "--settings", str(settings), environment={})


def _await_streams(agent: AgentProcess, recorder: Recorder, sources: Iterable[str]) -> None:
    end = time.monotonic() + DEADLINE_S
    while not all(recorder.newest(each) for each in sources):
        assert agent.is_running, agent.console()
        assert time.monotonic() < end, "nothing streams"
        time.sleep(0.1)


def _reanchors(agent: AgentProcess) -> int:
    return agent.devices()[ZEPHYR]["clock"]["reanchors"]


def _jump(zephyr: SteeredBioHarness, agent: AgentProcess) -> Iterator[tuple[float, int]]:
    """Set the clock of the BioHarness; give when, and the re-anchors that the agent then says."""
    for jump_s in JUMPS_S:
        before, jumped_s = _reanchors(agent), local_clock()
        zephyr.step_clock(jump_s)
        wait_until(lambda before=before: _reanchors(agent) > before, "a re-anchored clock")
        reanchors = _reanchors(agent)
        time.sleep(EACH_S)
        yield jumped_s, reanchors


def _ecg(sent: Iterable[Outgoing]) -> Samples:
    """Return when each sample of the ECG was measured, and its value; on Linux the clocks agree."""
    times: list[float] = []
    values: list[NDArray[np.int64]] = []
    for frame in sent:
        if frame.packet is Packet.ECG and frame.samples is not None and frame.measured_at:
            times += (
                frame.measured_at + (frame.period_s or 0.0) * np.arange(len(frame.samples))
            ).tolist()
            values.append(frame.samples)
    return Samples(np.array(times), np.concatenate(values).astype(np.float64))


@pytest.mark.parametrize("name", STREAMS)
def test_the_stamps_are_the_times_of_measuring(
    observed: Observed, figures: Record, name: str
) -> None:
    errors = observed.errors_s(name)
    rms_s = float(np.std(errors.steady_s))
    steady_s, jumped_s, later_s = (float(np.abs(each).max()) for each in errors)
    figures(FAULTS[name], "stamp RMS, constant removed", "≤ 3 ms", f"{1000 * rms_s:.2f} ms")
    figures(
        FAULTS[name],
        f"worst stamp error; within {ANCHORED_S:g} s of a jump; after that",
        "reported",
        "; ".join(f"{1000 * each:.2f} ms" for each in (steady_s, jumped_s, later_s)),
    )
    assert rms_s <= LIMIT_RMS_S
    assert max(steady_s, later_s) <= LIMIT_S


@pytest.mark.parametrize("name", STREAMS)
def test_the_stamps_are_monotone_and_nothing_is_lost(
    observed: Observed, figures: Record, name: str
) -> None:
    stamps_s = observed.received[name].times
    lost = {s: each["lost"] for s, each in observed.status[name]["streams"].items()}
    backward = int((np.diff(stamps_s) <= 0).sum())
    figures(
        FAULTS[name],
        "LSL stamps that run back; samples lost",
        "0; 0",
        f"{backward}; {sum(lost.values())}",
    )
    assert backward == 0
    assert not any(lost.values()), lost
    places = match(observed.received[name], observed.truth[name])
    assert (np.diff(places) == 1).all()


def test_a_turn_is_no_jump(observed: Observed) -> None:
    assert observed.reanchors == 0
    assert observed.status[SHIMMER]["clock"]["reanchors"] == 0


def test_each_jump_is_reported_once(observed: Observed, figures: Record) -> None:
    said = [r for r in observed.log if "the device's clock jumped" in r["event"]]
    figures(FAULTS[ZEPHYR], "reports of the agent, for two jumps", "2", str(len(said)))
    assert [reanchors for _, reanchors in observed.jumps] == [1, 2]
    assert observed.status[ZEPHYR]["clock"]["reanchors"] == len(JUMPS_S)
    assert [(r["sensor"], r["level"]) for r in said] == [(ZEPHYR, "warning")] * len(JUMPS_S)
