"""``pause`` and ``resume`` in a real agent: what is sent, what is kept, what events tell."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pylsl
import pytest
from numpy.typing import NDArray

from biosensor_common import naming
from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.pauses import PAUSED_FILE
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.stages import RESUME_GUARD_S
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.rigs.bluetooth import virtual_world
from tests.rigs.driver_run import Run, streaming
from tests.rigs.gateway import cli_process, inlet
from tests.rigs.polling import until, wait_until
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

NO_AGENT = "biosensor-gateway: no agent is running; start one with: biosensor-gateway run\n"
DEADLINE_S = 30.0
# More than can wait in an inlet while the commands run.
ALL_SAMPLES = 1 << 16


def command(folder: Path, *arguments: str) -> tuple[int, str, str]:
    ended = subprocess.run(
        [sys.executable, "-m", "biosensor_gateway.cli", *arguments],
        env=os.environ | {"BIOSENSOR_GATEWAY_STATE": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    return ended.returncode, ended.stdout, ended.stderr


def device(folder: Path) -> dict[str, Any]:
    """Return the first device of the agent's status; empty while there is none."""
    try:
        return status_file.read_status(folder)["devices"][0]
    except ConfigError:
        return {}


def counted(folder: Path, key: str) -> int:
    return sum(counters[key] for counters in device(folder).get("streams", {}).values())


@pytest.fixture
def harness() -> Generator[SteeredBioHarness]:
    with SteeredBioHarness() as running:
        yield running


@pytest.fixture
def run(tmp_path: Path, harness: SteeredBioHarness, unit: str) -> tuple[str, ...]:
    path = tmp_path / "settings.toml"
    text = f'[[device]]\nsensor = "zephyr"\nunit = "{unit}"\nport = "{harness.port}"\n'
    path.write_text(f'{text}participant = "p01"\n')
    return "run", "--settings", str(path)


@pytest.mark.seam
def test_a_participant_withdraws_and_comes_back(
    tmp_path: Path,
    run: tuple[str, ...],
    unit: str,
) -> None:
    with cli_process(tmp_path, *run) as agent:
        wait_until(lambda: counted(tmp_path, "pushed") > 0)
        reader = inlet("p01@zephyr-ecg")
        wait_until(lambda: bool(reader.pull_chunk(timeout=0.0)[1]))
        assert command(tmp_path, "pause", "zephyr") == (
            0,
            (
                f"zephyr/{unit} is paused: nothing is sent from it until you run: "
                f"biosensor-gateway resume zephyr/{unit}\n"
            ),
            "",
        )
        answered_s = pylsl.local_clock()
        wait_until(lambda: device(tmp_path)["paused"])
        assert device(tmp_path)["state"] == "streaming"
        shown = command(tmp_path, "status")[1]
        assert f"p01 zephyr ({unit}): paused (streaming)" in " ".join(shown.split())
        withheld = counted(tmp_path, "withheld")
        wait_until(lambda: counted(tmp_path, "withheld") > withheld + 500)
        before = reader.pull_chunk(timeout=0.0, max_samples=ALL_SAMPLES)[1]
        assert all(stamp < answered_s for stamp in before)
        assert command(tmp_path, "pause", "p01")[:2] == (
            0,
            (
                f"zephyr/{unit} was already paused: nothing is sent from it until you run: "
                f"biosensor-gateway resume zephyr/{unit}\n"
            ),
        )
        sent = counted(tmp_path, "pushed")
        resumed_s = pylsl.local_clock()
        assert command(tmp_path, "resume", f"zephyr/{unit}") == (
            0,
            f"zephyr/{unit} is sent again\n",
            "",
        )
        stamps: list[float] = []
        wait_until(lambda: bool(stamps.extend(reader.pull_chunk(timeout=0.0)[1]) or stamps))
        assert stamps[0] > resumed_s
        wait_until(lambda: counted(tmp_path, "pushed") > sent)
        assert not device(tmp_path)["paused"]
        assert device(tmp_path)["connections"] == 1
        assert counted(tmp_path, "lost") == 0
        assert command(tmp_path, "resume", "p01")[:2] == (0, f"zephyr/{unit} was not paused\n")
        assert not (tmp_path / PAUSED_FILE).exists()
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) == 0


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_who_has_withdrawn_is_not_streamed_by_the_next_agent(
    tmp_path: Path,
    run: tuple[str, ...],
    unit: str,
    end: signal.Signals,
) -> None:
    with cli_process(tmp_path, *run) as first:
        wait_until(lambda: counted(tmp_path, "pushed") > 0)
        assert command(tmp_path, "pause", "p01")[0] == 0
        first.send_signal(end)
        first.wait()
    (tmp_path / status_file.STATUS_FILE).unlink(missing_ok=True)
    with cli_process(tmp_path, *run) as second:
        wait_until(lambda: counted(tmp_path, "withheld") > 500)
        assert (counted(tmp_path, "pushed"), counted(tmp_path, "lost")) == (0, 0)
        said = (tmp_path / LOG_FILE_NAME).read_text()
        assert f"biosensor-gateway resume zephyr/{unit}" in said
        assert "is paused" in (tmp_path / "stderr.txt").read_text()
        assert command(tmp_path, "resume", "p01")[0] == 0
        wait_until(lambda: counted(tmp_path, "pushed") > 0)
        second.send_signal(signal.SIGTERM)
        assert second.wait(DEADLINE_S) == 0
    with cli_process(tmp_path, *run) as third:
        wait_until(lambda: counted(tmp_path, "pushed") > 0)
        third.send_signal(signal.SIGTERM)
        assert third.wait(DEADLINE_S) == 0


def test_names_that_are_none_or_several_are_refused_in_one_sentence(
    tmp_path: Path, run: tuple[str, ...], unit: str
) -> None:
    more = '[[device]]\nsensor = "zephyr"\nunit = "other"\nport = "nowhere"\n'
    path = Path(run[-1])
    path.write_text(path.read_text() + more)
    with cli_process(tmp_path, *run) as agent:
        wait_until(lambda: counted(tmp_path, "pushed") > 0)
        assert command(tmp_path, "pause", "zephyr") == (
            1,
            "",
            (
                "biosensor-gateway: the agent refused pause: several devices have the name "
                f"'zephyr'; choose one: zephyr/{unit} (p01), zephyr/other\n"
            ),
        )
        assert command(tmp_path, "resume", "p02") == (
            1,
            "",
            (
                "biosensor-gateway: the agent refused resume: no device has the name 'p02'; "
                f"there are: zephyr/{unit} (p01), zephyr/other\n"
            ),
        )
        assert not device(tmp_path)["paused"]
        # One that was never connected can be paused as well.
        assert command(tmp_path, "pause", "zephyr/other")[0] == 0
        wait_until(lambda: status_file.read_status(tmp_path)["devices"][1]["paused"])
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) == 0


def test_without_an_agent_it_says_so(tmp_path: Path) -> None:
    for name in ("pause", "resume"):
        assert command(tmp_path / "state", name, "zephyr") == (1, "", NO_AGENT)
    assert list(tmp_path.iterdir()) == []


def test_a_pause_that_cannot_be_kept_holds_and_is_said(
    tmp_path: Path, run: tuple[str, ...], unit: str
) -> None:
    with cli_process(tmp_path, *run) as agent:
        wait_until(lambda: counted(tmp_path, "pushed") > 0)
        # A folder cannot be replaced by a file.
        (tmp_path / PAUSED_FILE).mkdir()
        code, out, err = command(tmp_path, "pause", "zephyr")
        assert (code, f"zephyr/{unit} is paused" in out) == (1, True)
        assert err.count("\n") == 1
        assert str(tmp_path / PAUSED_FILE) in err
        assert "restarting the agent would stream it again" in err
        wait_until(lambda: device(tmp_path)["paused"])
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) == 0


def test_if_it_cannot_be_read_who_has_withdrawn_nothing_is_streamed(
    tmp_path: Path, run: tuple[str, ...], harness: SteeredBioHarness
) -> None:
    (tmp_path / PAUSED_FILE).write_text("{")
    code, out, err = command(tmp_path, *run)
    assert (code, out) == (2, "")
    assert "cannot read who has withdrawn" in err
    assert "Traceback" not in err
    assert not harness.sent


# A virtual strap is paused and resumed: what a real inlet gets, against what it measured when.

__all__ = ["virtual_world"]
ECG_RATE_HZ = 130.0
JITTER_S = 0.05
Floats = NDArray[np.float64]


class Stage:
    """One stream of a strap: what it measured, what the driver emitted, what an inlet gets."""

    def __init__(
        self, strap: SimulatedPolarH10, run: Run, reader: pylsl.StreamInlet, name: str
    ) -> None:
        self.run, self._strap, self._reader, self._name = run, strap, reader, name

    @property
    def counters(self) -> Counters:
        return self.run.sink.counters[naming.source_id(self.run.sink.identity, self._name)]

    @property
    def emitted(self) -> Floats:
        """Stamps that the driver gave, whether the samples were sent or not."""
        return np.array(self.run.sink.times[self._name])

    async def received(self) -> Floats:
        """Stop the flow, and return the stamps of all that came."""
        self.run.sink.pause()
        stamps: list[float] = []

        def is_complete() -> bool:
            stamps.extend(self._reader.pull_chunk(timeout=0.2)[1])
            return bool(stamps) and stamps[-1] >= self.counters.last_stamp

        await until(is_complete)
        return np.array(stamps)

    def measured(self, stamps: Floats) -> Floats:
        """Return when samples were measured in truth, by their stamps, which must be unchanged."""
        index = np.searchsorted(self.emitted, stamps - 1e-6)
        np.testing.assert_allclose(self.emitted[index], stamps, rtol=0, atol=1e-6)
        # The strap's first sample is the first that was emitted; nothing was lost on the way.
        return self._strap.truth.samples(self._name).times[index]


Open = Callable[[str], AbstractAsyncContextManager[tuple[Stage, SimulatedPolarH10]]]


@pytest.fixture
def radio(virtual_world: World) -> Generator[Radio]:
    radio = Radio(virtual_world)
    with virtual_bluetooth(radio):
        yield radio


@pytest.fixture
def stage(radio: Radio, monkeypatch: pytest.MonkeyPatch) -> Open:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)

    @asynccontextmanager
    async def opened(name: str) -> AsyncGenerator[tuple[Stage, SimulatedPolarH10]]:
        wearer = Wearer(seed=5, heart_rate_bpm=100)
        strap = SimulatedPolarH10(radio.world, radio, wearer=wearer, jitter_s=JITTER_S)
        with strap:
            async with streaming(strap) as run:
                await until(run.sink.has(1, name))
                source = naming.source_id(run.sink.identity, name)
                yield Stage(strap, run, await asyncio.to_thread(inlet, source), name), strap

    return opened


@pytest.mark.parametrize("name", ["ecg", "acc"])
async def test_nothing_measured_in_the_pause_is_ever_sent(stage: Open, name: str) -> None:
    async with stage(name) as (stream, _):
        sink = stream.run.sink
        attached_s = stream.run.sink.clock()
        await stream.run.goes_on(3, "hr")
        before = len(stream.emitted)
        paused_s = stream.run.sink.clock()
        sink.pause()
        await stream.run.goes_on(3, "hr")
        assert (stream.counters.pushed, stream.counters.withheld > 0) == (before, True)
        resumed_s = stream.run.sink.clock()
        sink.resume()
        await stream.run.goes_on(4, "hr")
        emitted = stream.emitted
        stamps = await stream.received()
        measured = stream.measured(stamps)
        assert stream.run.supervisor.connections == 1
        assert (stream.counters.lost, stream.counters.refused) == (0, 0)
    assert not ((measured > paused_s) & (measured < resumed_s)).any()
    # All that was emitted before is there, and all that was measured after.
    assert set(emitted[:before][emitted[:before] > attached_s + 1]) <= set(stamps)
    later = emitted[emitted > resumed_s + RESUME_GUARD_S + 0.01]
    assert len(later) > 100
    assert set(later) <= set(stamps)


async def test_it_stays_paused_over_a_drop_out_and_goes_on_in_the_same_outlets(
    stage: Open,
) -> None:
    async with stage("ecg") as (stream, strap):
        await stream.run.goes_on(2, "hr")
        before = stream.counters.pushed
        in_work_s = stream.run.sink.clock() - stream.emitted[-1]
        stream.run.sink.pause()
        strap.apply(Fault(FaultKind.DROP, 1.0))
        await until(lambda: stream.run.supervisor.connections == 2)
        await stream.run.goes_on(2, "hr")
        await stream.run.goes_on(100, "ecg")
        assert stream.counters.pushed == before
        # What was measured just before the pause did get lost; of the pause nothing did.
        assert stream.counters.lost <= in_work_s * ECG_RATE_HZ + 2
        stream.run.sink.resume()
        resumed_s = stream.run.sink.clock()
        await until(lambda: stream.counters.pushed > before + 200)
        stamps = await stream.received()
        assert stream.counters.refused == 0
    after = stamps[stamps > resumed_s]
    assert len(after) > 200
    np.testing.assert_allclose(np.diff(after), 1 / ECG_RATE_HZ, rtol=0.02)


async def test_of_a_drop_out_that_outlasts_the_pause_only_the_end_is_lost(
    stage: Open,
) -> None:
    async with stage("ecg") as (stream, strap):
        await stream.run.goes_on(2, "hr")
        before = stream.counters.pushed
        stream.run.sink.pause()
        strap.apply(Fault(FaultKind.DROP, float("inf")))
        await until(lambda: stream.run.supervisor.state is State.DISCOVERING)
        paused_s = stream.run.sink.clock()
        await until(lambda: stream.run.sink.clock() > paused_s + 4.0)
        stream.run.sink.resume()
        resumed_s = stream.run.sink.clock()
        await until(lambda: stream.run.sink.clock() > resumed_s + 3.0)
        strap.clear(FaultKind.DROP)
        await until(lambda: stream.counters.pushed > before + 100)
        stamps = await stream.received()
        lost = stream.counters.lost
    first_after = stamps[stamps > resumed_s][0]
    # Of seven seconds and more, those between the pause and the return.
    missing_s = first_after - resumed_s - RESUME_GUARD_S
    assert missing_s > 1.5
    assert lost / ECG_RATE_HZ == pytest.approx(missing_s, abs=1.0)


# The agent announces what happens to a device: a real process, a virtual device, a real inlet.
SOURCE = naming.source_id(DeviceIdentity("gateway", socket.gethostname()), "events")
DEVICE = {"sensor": "zephyr", "unit": "virtual"}
DROP_S = 3.0


def lost_by_status(folder: Path) -> dict[str, int]:
    """Return the lost samples of the only device by data name, of those that lost any."""
    streams = status_file.read_status(folder)["devices"][0]["streams"]
    lost = {source.rpartition("-")[2]: counted["lost"] for source, counted in streams.items()}
    return {name: count for name, count in lost.items() if count}


def test_a_drop_out_explains_itself(tmp_path: Path) -> None:
    heard: list[tuple[dict[str, Any], float]] = []
    settings = ("run", "--simulate", "zephyr", "--fault", f"drop:{DROP_S:g}s@15s")
    with cli_process(tmp_path, *settings) as agent:
        reader = inlet(SOURCE, recover=True)

        def has(*kinds: str) -> bool:
            samples, stamps = reader.pull_chunk(timeout=0.0)
            texts = (row[0] for row in samples)
            heard.extend(zip(map(json.loads, texts), stamps, strict=True))
            return {*kinds} <= {event["event"] for event, _ in heard}

        wait_until(lambda: has("heartbeat", "disconnected", "gap_start", "connected", "gap_end"))

        def announced() -> Counter[str]:
            has()
            return sum((Counter[str](each.get("lost", {})) for each, _ in heard), Counter[str]())

        # A slow stream may be told behind the others, in a gap of its own.
        wait_until(lambda: announced() == Counter(lost_by_status(tmp_path)))
        agent.send_signal(signal.SIGTERM)
        wait_until(lambda: has("agent_stopped"))
        assert agent.wait(DEADLINE_S) == 0
        assert "Traceback" not in (tmp_path / "stderr.txt").read_text()

    stamps = [stamp for _, stamp in heard]
    assert stamps == sorted(set(stamps))
    # Of each kind the first, as far as it was heard.
    said = {event["event"]: event for event, _ in reversed(heard)}
    assert heard[-1][0]["event"] == "agent_stopped"
    for kind in ("disconnected", "gap_start", "connected", "gap_end"):
        assert said[kind].items() >= DEVICE.items()
    assert said["disconnected"]["reason"] == "lost"
    assert 2 in {event.get("connection") for event, _ in heard}
    start, end = said["gap_start"]["lsl_time"], said["gap_end"]["lsl_time"]
    assert end - start > DROP_S - 1.1
    assert abs(said["gap_end"]["lost"]["ecg"] / 250 - (end - start)) < 1.1
    # By the heartbeats one can tell in which state a recording began.
    states = [event["devices"] for event, _ in heard if event["event"] == "heartbeat"]
    assert {"zephyr/virtual": "streaming"} in states
