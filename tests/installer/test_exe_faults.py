"""The installed program outlives restarts of a server, pulled ports and silent devices.

All devices have a fault at the same time, and the program is never started again. Limits
are those of the fault matrix on Linux.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Generator, Iterable
from math import inf
from typing import Any, TypeVar

import numpy as np
import pylsl
import pytest
from pylsl import local_clock

from biosensor_gateway.devices.empatica_e4.simulator import SimulatedE4
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.shimmer3_gsr.simulator import SimulatedShimmer3
from biosensor_gateway.devices.zephyr.simulator import SimulatedZephyr
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.simulation.world import World
from installer.wine.prefix import windows_path
from tests.faults.episode import Episode, Stock
from tests.faults.expectations import (
    is_by_agent,
    numeric_streams,
    regular_streams,
    source,
    steady_streams,
    unit_of,
)
from tests.faults.matching import NEAR_S, UnknownSampleError
from tests.faults.recorder import Recorded, Recorder
from tests.rigs.lab_client import Samples
from tests.rigs.windows.clocks import read_clocks
from tests.rigs.windows.pc import WindowsPc
from tests.rigs.windows.program import RunningProgram, lively, program_environment

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

DEADLINE_S = 90.0
HOLD_S = 3.0
PORTS = {"shimmer3_gsr": 7, "zephyr": 12}
"""Windows opens ports above COM9 by another name."""
SENSORS = ("empatica_e4", *PORTS)
REGULAR = {source(name, each) for name in SENSORS for each in regular_streams(name)}
CUT, SILENT = "cut", "silent"
KINDS = {
    CUT: {
        "empatica_e4": FaultKind.RESTART,
        "shimmer3_gsr": FaultKind.DROP,
        "zephyr": FaultKind.DROP,
    },
    SILENT: dict.fromkeys(SENSORS, FaultKind.STALL),
}
"""In a drop the pseudo-terminal hangs up and its name is gone; a new one has the same name."""

_ItemT = TypeVar("_ItemT")
EVERY_CELL = pytest.mark.parametrize(
    ("what", "name"), [(what, name) for what in KINDS for name in SENSORS]
)


class WindowsFaultBench:
    """The devices, the program that streams from them, and a recorder on Linux."""

    def __init__(
        self, devices: dict[str, VirtualDevice], program: RunningProgram, recorder: Recorder
    ) -> None:
        self.program = program
        self._devices = devices
        self._recorder = recorder
        self._clock_difference_s = read_clocks().windows_minus_lsl
        self._episodes: dict[str, dict[str, Episode]] = {}
        self.identities: list[tuple[dict[str, str], int]] = []

    def episode(self, what: str, name: str) -> Episode:
        """Return what a fault did to one device; all have theirs at the first call."""
        if what not in self._episodes:
            self._note_identities()
            self._episodes[what] = self._run(KINDS[what])
            self._note_identities()
        return self._episodes[what][name]

    def streams_since(self, name: str, begin_s: float) -> bool:
        """Whether all steady streams of a device have a sample from after an LSL time."""
        newest = (self._recorded(name, each).times[-1:] for each in steady_streams(name))
        return all(len(times) and times[0] > begin_s for times in newest)

    def _run(self, kinds: dict[str, FaultKind]) -> dict[str, Episode]:
        episodes = {
            name: Episode((kind,), local_clock(), {name: self._stock(name)})
            for name, kind in kinds.items()
        }
        # What is received on both sides of a gap shows how wide it is.
        wait_for(SENSORS, lambda name: self.streams_since(name, episodes[name].begin_s))
        logged = len(self.program.log())
        for name, kind in kinds.items():
            self._devices[name].apply(Fault(kind, inf))

        def is_noticed(name: str) -> bool:
            episodes[name].log = self.program.log()[logged:]
            return bool(episodes[name].warnings(name))

        unnoticed = wait_for(kinds, is_noticed)
        assert not unnoticed, f"not noticed: {unnoticed}: {self.program.said()}"
        time.sleep(HOLD_S)
        for name, kind in kinds.items():
            episodes[name].end_s[kind, name] = local_clock()
            self._devices[name].clear(kind)
        self._await_recovery(episodes)
        # Some losses are known only when a window closes.
        wait_for(SENSORS, lambda name: self._balances(episodes[name], name))
        return episodes

    def _await_recovery(self, episodes: dict[str, Episode]) -> None:
        def recovers(name: str) -> bool:
            ((cell, end_s),) = episodes[name].end_s.items()
            if self.streams_since(name, end_s):
                episodes[name].recovered_s[cell] = local_clock() - end_s
            return cell in episodes[name].recovered_s

        wait_for(SENSORS, recovers)

    def _balances(self, episode: Episode, name: str) -> bool:
        since_s = episode.before[name].time_s
        stock = episode.after[name] = self._stock(name)
        for data_name in numeric_streams(name):
            episode.received[name, data_name] = self._recorded(name, data_name).since(since_s)
            truth = self._devices[name].truth.samples(data_name)
            recent = truth.times >= since_s - NEAR_S
            episode.truth[name, data_name] = Samples(truth.times[recent], truth.values[recent])
        stamps = [counters["last_stamp"] for counters in stock.status["streams"].values()]
        ended_s = max(episode.end_s.values())
        try:
            is_right = not episode.imbalance(name)
        except UnknownSampleError:
            return False
        return is_right and max(stamps) - self._clock_difference_s > ended_s

    def _stock(self, name: str) -> Stock:
        time_s, devices = local_clock(), self.program.report()["devices"]
        return Stock(time_s, next(each for each in devices if each["sensor"] == name))

    def _recorded(self, name: str, data_name: str) -> Recorded:
        recorded = self._recorder.recorded(source(name, data_name))
        return recorded._replace(times=recorded.times - self._clock_difference_s)

    def _note_identities(self) -> None:
        """Note which outlets there are, and of which process."""
        sources = {source(name, each) for name in SENSORS for each in numeric_streams(name)}
        wanted = self.identities[0][0].keys() if self.identities else REGULAR
        deadline, uids = time.monotonic() + DEADLINE_S, dict[str, str]()
        # One look may miss some of many.
        while not wanted <= uids.keys() and time.monotonic() < deadline:
            found = pylsl.resolve_streams(2.0)
            uids = {info.source_id(): info.uid() for info in found if info.source_id() in sources}
        self.identities.append((uids, self.program.report()["process"]))


@pytest.fixture(scope="module")
def bench(
    installed: WindowsPc, tmp_path_factory: pytest.TempPathFactory
) -> Generator[WindowsFaultBench]:
    """All devices stream; the ports were plugged in while the program looked for them."""
    folder = tmp_path_factory.mktemp("exe")
    prefix = lively(installed, program_environment(folder))
    channels = {
        source(name, each): len(declaration(name).stream(each).channels)
        for name in SENSORS
        for each in numeric_streams(name)
    }
    with (
        World() as world,
        SimulatedE4(world) as e4,
        SimulatedShimmer3(world) as shimmer,
        SimulatedZephyr(world) as zephyr,
    ):
        devices: dict[str, VirtualDevice] = {
            "empatica_e4": e4,
            "shimmer3_gsr": shimmer,
            "zephyr": zephyr,
        }
        settings = folder / "settings.toml"
        settings.write_text(_settings(devices), encoding="utf-8")
        options = ("--settings", windows_path(settings))
        with (
            RunningProgram(prefix, installed.program, folder, *options) as program,
            Recorder(channels) as recorder,
        ):
            running = WindowsFaultBench(devices, program, recorder)
            _plug_in(installed, running, devices)
            yield running


def _settings(devices: dict[str, VirtualDevice]) -> str:
    blocks: list[str] = []
    for name, device in devices.items():
        fields: dict[str, Any] = {"sensor": name, "unit": unit_of(name), **device.settings}
        if name in PORTS:
            fields["port"] = f"COM{PORTS[name]}"
        lines = [f"{key} = {json.dumps(value)}" for key, value in fields.items()]
        blocks.append("\n".join(["[[device]]", *lines]))
    return "\n\n".join(blocks) + "\n"


def _plug_in(pc: WindowsPc, bench: WindowsFaultBench, devices: dict[str, VirtualDevice]) -> None:
    absent = wait_for(
        PORTS, lambda name: "no such port" in (bench.program.device(name).get("error") or "")
    )
    assert not absent, bench.program.said()
    begin_s = local_clock()
    for name, com in PORTS.items():
        pc.plug_in(com, devices[name].settings["port"])
    silent = wait_for(SENSORS, lambda name: bench.streams_since(name, begin_s))
    assert not silent, f"no samples of {silent}: {bench.program.said()}"


def wait_for(items: Iterable[_ItemT], condition: Callable[[_ItemT], bool]) -> list[_ItemT]:
    """Wait until a condition has held for every item; return those for which it never did."""
    left = list(items)
    deadline = time.monotonic() + DEADLINE_S
    while left and time.monotonic() < deadline:
        time.sleep(0.1)
        left = [item for item in left if not condition(item)]
    return left


@EVERY_CELL
def test_it_is_said_in_one_sentence(bench: WindowsFaultBench, what: str, name: str) -> None:
    warnings = bench.episode(what, name).warnings(name)
    assert warnings
    for record in warnings:
        assert (record["unit"], record["level"]) == (unit_of(name), "warning")
        assert "exception" not in record
        assert record["event"].isprintable()


@EVERY_CELL
def test_it_goes_on_by_itself(bench: WindowsFaultBench, what: str, name: str) -> None:
    episode = bench.episode(what, name)
    kind = KINDS[what][name]
    assert (kind, name) in episode.recovered_s, bench.program.said()
    before, after = episode.before[name].status, episode.after[name].status
    assert (after["state"], after["error"]) == ("streaming", None)
    # A silent device may be heard again as soon as its streams are enabled again.
    assert after["connections"] > before["connections"] or what == SILENT


@EVERY_CELL
def test_what_is_lost_is_counted(bench: WindowsFaultBench, what: str, name: str) -> None:
    assert not bench.episode(what, name).imbalance(name)


@EVERY_CELL
def test_nothing_comes_twice_or_out_of_order(
    bench: WindowsFaultBench, what: str, name: str
) -> None:
    episode = bench.episode(what, name)
    for data_name in numeric_streams(name):
        assert (np.diff(episode.received[name, data_name].times) > 0).all(), data_name
        assert episode.counted(name, data_name, "refused") == 0, data_name
        if not is_by_agent(name, data_name) and len(episode.truth[name, data_name].times):
            episode.matched(name, data_name)


def test_the_streams_are_the_same_all_the_time(bench: WindowsFaultBench) -> None:
    for what in KINDS:
        bench.episode(what, SENSORS[0])
    outlets, process = bench.identities[0]
    assert outlets.keys() >= REGULAR
    assert all(each == process for _, each in bench.identities)
    for later, _ in bench.identities:
        assert later.items() >= outlets.items()
    assert bench.program.is_running
    assert "Traceback" not in bench.program.said()
