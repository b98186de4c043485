"""The agent as a process: it ends on request in every situation, and leaves nothing behind."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import termios
import time
from collections.abc import Awaitable, Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pylsl
import pytest

from biosensor_common import naming
from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import agent as agent_module
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import Agent
from biosensor_gateway.agent.device_set import Device, DeviceSet
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.driver import Connected
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.streaming.sink import DeviceSink
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

ENDED_WITHIN_S = 15.0
OPENING_TAKES_A_MINUTE = """
import time, serial
serial.Serial.__init__ = lambda *arguments, **options: time.sleep(60)
"""

Until = Callable[[Callable[[], bool]], None]
Eventually = Callable[[Callable[[], bool]], Awaitable[None]]
Visible = Callable[[str], bool]
OpenInlet = Callable[[str], pylsl.StreamInlet]
StartCli = Callable[..., AbstractContextManager["subprocess.Popen[bytes]"]]

BOTH_SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


def device_of(folder: Path) -> dict[str, Any]:
    """Return the only device of a running agent's status; empty while there is none."""
    try:
        devices = status_file.read_status(folder)["devices"]
    except ConfigError:
        return {}
    return devices[0] if devices else {}


def is_streaming(folder: Path) -> bool:
    streams = device_of(folder).get("streams", {})
    return any(counters["pushed"] for counters in streams.values())


def write_settings(folder: Path, port: str, unit: str) -> list[str]:
    path = folder / "settings.toml"
    path.write_text(f'[[device]]\nsensor = "zephyr"\nunit = "{unit}"\nport = "{port}"\n')
    return ["run", "--settings", str(path)]


def end(process: subprocess.Popen[bytes], number: signal.Signals, folder: Path) -> None:
    process.send_signal(number)
    assert process.wait(ENDED_WITHIN_S) == 0
    left = {path.name for path in folder.iterdir()}
    assert left <= {"biosensor-gateway.log", "stderr.txt", "settings.toml"}
    assert "Traceback" not in (folder / "stderr.txt").read_text()


@pytest.mark.seam
@BOTH_SIGNALS
def test_it_ends_while_streaming_and_its_streams_vanish(
    cli_process: StartCli,
    until: Until,
    visible: Visible,
    tmp_path: Path,
    unit: str,
    number: signal.Signals,
) -> None:
    with (
        SteeredBioHarness() as device,
        cli_process(tmp_path, *write_settings(tmp_path, device.port, unit)) as process,
    ):
        until(lambda: is_streaming(tmp_path))
        until(lambda: visible(f"zephyr-{unit}-ecg"))
        end(process, number, tmp_path)
        until(lambda: device.switched_on == frozenset())
    until(lambda: not visible(f"zephyr-{unit}-ecg"))


@BOTH_SIGNALS
def test_it_ends_while_the_device_is_absent(
    cli_process: StartCli, until: Until, tmp_path: Path, unit: str, number: signal.Signals
) -> None:
    arguments = write_settings(tmp_path, str(tmp_path / "ttyUSB9"), unit)
    with cli_process(tmp_path, *arguments) as process:
        until(lambda: device_of(tmp_path).get("error") is not None)
        end(process, number, tmp_path)


@BOTH_SIGNALS
def test_it_ends_while_the_device_does_not_answer(
    cli_process: StartCli, until: Until, tmp_path: Path, pty: Any, unit: str, number: signal.Signals
) -> None:
    with cli_process(tmp_path, *write_settings(tmp_path, pty.port, unit)) as process:
        until(lambda: pty.heard() != b"")
        until(lambda: device_of(tmp_path).get("state") == "connecting")
        end(process, number, tmp_path)


@BOTH_SIGNALS
def test_it_ends_while_a_port_is_opening(
    cli_process: StartCli, until: Until, tmp_path: Path, unit: str, number: signal.Signals
) -> None:
    arguments = write_settings(tmp_path, "COM7", unit)
    with cli_process(tmp_path, *arguments, before=OPENING_TAKES_A_MINUTE) as process:
        until(lambda: device_of(tmp_path).get("state") == "connecting")
        end(process, number, tmp_path)


@contextmanager
def writing_blocked(port: str) -> Generator[None]:
    """Take nothing more from whoever has the port open."""
    handle = os.open(port, os.O_RDWR | os.O_NOCTTY)
    termios.tcflow(handle, termios.TCOOFF)
    yield
    os.close(handle)


@BOTH_SIGNALS
def test_it_ends_while_the_device_is_out_of_reach(
    cli_process: StartCli, until: Until, tmp_path: Path, unit: str, number: signal.Signals
) -> None:
    with (
        SteeredBioHarness() as device,
        cli_process(tmp_path, *write_settings(tmp_path, device.port, unit)) as process,
    ):
        until(lambda: is_streaming(tmp_path))
        with writing_blocked(device.port):
            device.stall()
            end(process, number, tmp_path)


def test_an_impatient_second_signal_cuts_nothing_short(
    cli_process: StartCli, until: Until, tmp_path: Path, unit: str
) -> None:
    with (
        SteeredBioHarness() as device,
        cli_process(tmp_path, *write_settings(tmp_path, device.port, unit)) as process,
    ):
        until(lambda: is_streaming(tmp_path))
        with writing_blocked(device.port):
            device.stall()
            process.send_signal(signal.SIGINT)
            # Closing takes a second now, because a write is blocked.
            time.sleep(0.2)
            end(process, signal.SIGINT, tmp_path)


def status(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "biosensor_gateway.cli", "status", *options],
        env=os.environ | {"BIOSENSOR_GATEWAY_STATE": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.seam
def test_status_follows_a_virtual_device_from_start_to_kill(
    cli_process: StartCli, until: Until, tmp_path: Path
) -> None:
    assert status(tmp_path).returncode == 1
    with cli_process(tmp_path, "run", "--simulate", "zephyr") as process:
        until(lambda: is_streaming(tmp_path))
        told = status(tmp_path)
        assert (told.returncode, told.stderr) == (0, "")
        assert "zephyr (virtual): streaming" in told.stdout
        (device,) = json.loads(status(tmp_path, "--json").stdout)["devices"]
        assert device["sensor"] == "zephyr"
        assert device["connections"] == 1
        assert device["clock"]["observations"] > 0
        assert len(device["streams"]) == 13
        process.kill()
        process.wait()
    # Nobody was left to remove the file; its age tells.
    until(lambda: device_of(tmp_path) == {})
    assert (tmp_path / status_file.STATUS_FILE).exists()
    assert status(tmp_path).returncode == 1


def test_the_counters_stream_tells_what_was_pushed(
    cli_process: StartCli, inlet: OpenInlet, tmp_path: Path
) -> None:
    gateway = DeviceIdentity("gateway", socket.gethostname())
    with cli_process(tmp_path, "run", "--simulate", "zephyr") as process:
        reader = inlet(naming.source_id(gateway, "counters"))
        ecg: dict[str, Any] = {}
        stamp: float | None = None
        while not ecg.get("pushed"):
            sample, stamp = reader.pull_sample(timeout=20.0)
            assert sample is not None
            ecg = json.loads(sample[0]).get("zephyr-virtual-ecg", {})
        assert ecg["pushed"] % 63 == 0
        assert ecg["lost"] == 0
        assert stamp is not None
        assert 0 < ecg["last_stamp"] <= stamp
        end(process, signal.SIGTERM, tmp_path)


def test_a_state_folder_that_cannot_be_written_stops_nothing(
    cli_process: StartCli, until: Until, visible: Visible, tmp_path: Path, unit: str
) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    before = f"import os\nos.environ['BIOSENSOR_GATEWAY_STATE'] = {str(in_the_way)!r}"
    with (
        SteeredBioHarness() as device,
        cli_process(tmp_path, *write_settings(tmp_path, device.port, unit), before=before) as agent,
    ):
        until(lambda: visible(f"zephyr-{unit}-ecg"))
        agent.send_signal(signal.SIGTERM)
        assert agent.wait(ENDED_WITHIN_S) == 0
    told = (tmp_path / "stderr.txt").read_text()
    assert "cannot write the log file" in told
    assert told.count("the status file cannot be written") == 1


class Bystander:
    """A driver that streams until it is stopped."""

    silence_limit_s = 3600.0

    def __init__(self) -> None:
        self.closed = False

    async def connect(self) -> Connected:
        return Connected()

    async def stream(self) -> None:
        await asyncio.Event().wait()

    async def close(self) -> None:
        self.closed = True


class DeadSupervisor(Supervisor):
    async def run(self) -> None:
        await asyncio.sleep(0.1)
        raise RuntimeError("a mistake in the supervisor")


async def test_if_a_supervisor_itself_dies_everything_is_closed_and_it_is_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, visible: Visible, unit: str
) -> None:
    # LSL is configured once a process, and here for all tests.
    monkeypatch.setattr(agent_module, "configure_lsl", lambda _overrides: None)  # pyright: ignore[reportUnknownLambdaType, reportUnknownArgumentType]
    agent, bystander = Agent(GatewaySettings(), tmp_path), Bystander()
    sinks = [
        DeviceSink(DeviceIdentity("gateway", f"{unit}{index}"), declaration("gateway"))
        for index in range(2)
    ]
    good = Supervisor(lambda: bystander, sinks[0])
    dead = DeadSupervisor(lambda: bystander, sinks[1])
    supervisors = zip([good, dead], sinks, strict=True)
    agent.devices = DeviceSet(
        {
            DeviceSettings(sensor="gateway", unit=sink.identity.unit): Device(supervisor, sink)
            for supervisor, sink in supervisors
        },
        Room(None),
    )
    with pytest.raises(RuntimeError, match="a mistake in the supervisor"):
        await asyncio.wait_for(agent.run(), ENDED_WITHIN_S)
    assert good.state is State.STOPPED
    assert bystander.closed
    assert device_of(tmp_path) == {}
    assert not visible(f"gateway-{unit}0-events")
