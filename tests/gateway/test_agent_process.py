"""The agent as a process: it ends on request in every situation, also by ``stop``."""

from __future__ import annotations

import asyncio
import json
import os
import random
import signal
import socket
import subprocess
import sys
import termios
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from biosensor_common import naming
from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import agent as agent_module
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import Agent
from biosensor_gateway.agent.control import CONTROL_FILE, TIME_LIMIT_S
from biosensor_gateway.agent.device_set import Device, DeviceSet
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.single_instance import LOCK_FILE, is_held
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.driver import Connected
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.rigs.gateway import cli_process, inlet, visible
from tests.rigs.polling import wait_until
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

# The agent as a process: it ends on request in every situation, and leaves nothing behind.

ENDED_WITHIN_S = 15.0
OPENING_TAKES_A_MINUTE = """
import time, serial
serial.Serial.__init__ = lambda *arguments, **options: time.sleep(60)
"""
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
    tmp_path: Path,
    unit: str,
    number: signal.Signals,
) -> None:
    with (
        SteeredBioHarness() as device,
        cli_process(tmp_path, *write_settings(tmp_path, device.port, unit)) as process,
    ):
        wait_until(lambda: is_streaming(tmp_path))
        wait_until(lambda: visible(f"zephyr-{unit}-ecg"))
        end(process, number, tmp_path)
        wait_until(lambda: device.switched_on == frozenset())
    wait_until(lambda: not visible(f"zephyr-{unit}-ecg"))


@BOTH_SIGNALS
def test_it_ends_while_the_device_is_absent(
    tmp_path: Path, unit: str, number: signal.Signals
) -> None:
    arguments = write_settings(tmp_path, str(tmp_path / "ttyUSB9"), unit)
    with cli_process(tmp_path, *arguments) as process:
        wait_until(lambda: device_of(tmp_path).get("error") is not None)
        end(process, number, tmp_path)


@BOTH_SIGNALS
def test_it_ends_while_the_device_does_not_answer(
    tmp_path: Path, pty: Any, unit: str, number: signal.Signals
) -> None:
    with cli_process(tmp_path, *write_settings(tmp_path, pty.port, unit)) as process:
        wait_until(lambda: pty.heard() != b"")
        wait_until(lambda: device_of(tmp_path).get("state") == "connecting")
        end(process, number, tmp_path)


@BOTH_SIGNALS
def test_it_ends_while_a_port_is_opening(tmp_path: Path, unit: str, number: signal.Signals) -> None:
    arguments = write_settings(tmp_path, "COM7", unit)
    with cli_process(tmp_path, *arguments, before=OPENING_TAKES_A_MINUTE) as process:
        wait_until(lambda: device_of(tmp_path).get("state") == "connecting")
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
    tmp_path: Path, unit: str, number: signal.Signals
) -> None:
    with (
        SteeredBioHarness() as device,
        cli_process(tmp_path, *write_settings(tmp_path, device.port, unit)) as process,
    ):
        wait_until(lambda: is_streaming(tmp_path))
        with writing_blocked(device.port):
            device.stall()
            end(process, number, tmp_path)


def test_an_impatient_second_signal_cuts_nothing_short(tmp_path: Path, unit: str) -> None:
    with (
        SteeredBioHarness() as device,
        cli_process(tmp_path, *write_settings(tmp_path, device.port, unit)) as process,
    ):
        wait_until(lambda: is_streaming(tmp_path))
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
def test_status_follows_a_virtual_device_from_start_to_kill(tmp_path: Path) -> None:
    assert status(tmp_path).returncode == 1
    with cli_process(tmp_path, "run", "--simulate", "zephyr") as process:
        wait_until(lambda: is_streaming(tmp_path))
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
    wait_until(lambda: device_of(tmp_path) == {})
    assert (tmp_path / status_file.STATUS_FILE).exists()
    assert status(tmp_path).returncode == 1


def test_the_counters_stream_tells_what_was_pushed(tmp_path: Path) -> None:
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


def test_a_state_folder_that_cannot_be_written_stops_nothing(tmp_path: Path, unit: str) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    before = f"import os\nos.environ['BIOSENSOR_GATEWAY_STATE'] = {str(in_the_way)!r}"
    with (
        SteeredBioHarness() as device,
        cli_process(tmp_path, *write_settings(tmp_path, device.port, unit), before=before) as agent,
    ):
        wait_until(lambda: visible(f"zephyr-{unit}-ecg"))
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
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, unit: str
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


# ``biosensor-gateway stop``, and agents that meet: real processes with one state folder.
DEADLINE_S = 30.0
NO_AGENT = "biosensor-gateway: no agent is running; start one with: biosensor-gateway run\n"
RUN = ("run", "--simulate", "zephyr")
# An agent that takes its time to close, as one with many devices out of reach.
CLOSING_TAKES_A_MINUTE = """
import time
from biosensor_gateway.agent import status_file
status_file.remove_status = lambda folder: time.sleep(60)
"""
# An agent that hangs as it closes, as liblsl does at times while it destroys an outlet.
CLOSING_NEVER_ENDS = """
import threading
from biosensor_gateway.agent import status_file
status_file.remove_status = lambda folder: threading.Event().wait()
"""
# An agent that takes its time to come up, and says when it has begun.
STARTING_TAKES_A_WHILE = """
import time
from biosensor_gateway.demo import virtual_devices as simulate
start = simulate.simulated_settings

def slowly(*arguments):
    time.sleep(5)
    return start(*arguments)

simulate.simulated_settings = slowly
"""


def command(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "biosensor_gateway.cli", *arguments],
        env=os.environ | {"BIOSENSOR_GATEWAY_STATE": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )


def stop(folder: Path, *options: str) -> tuple[int, str, str]:
    ended = command(folder, "stop", *options)
    return ended.returncode, ended.stdout, ended.stderr


def pushed(folder: Path) -> int:
    """How many samples the agent has sent; 0 while there is none."""
    try:
        devices: list[dict[str, Any]] = status_file.read_status(folder)["devices"]
    except ConfigError:
        return 0
    return sum(counters["pushed"] for device in devices for counters in device["streams"].values())


def said(folder: Path) -> str:
    return (folder / "stderr.txt").read_text()


@pytest.mark.seam
def test_stop_ends_the_agent_as_ctrl_c_does(tmp_path: Path) -> None:
    with cli_process(tmp_path, *RUN) as agent:
        wait_until(lambda: pushed(tmp_path) > 0)
        assert stop(tmp_path) == (0, "the agent has ended\n", "")
        assert agent.wait(DEADLINE_S) == 0
    assert {each.name for each in tmp_path.iterdir()} == {LOG_FILE_NAME, "stderr.txt"}
    assert "Traceback" not in said(tmp_path)
    assert stop(tmp_path) == (1, "", NO_AGENT)


def test_without_an_agent_stop_says_so_and_makes_no_folder(tmp_path: Path) -> None:
    assert stop(tmp_path / "state") == (1, "", NO_AGENT)
    assert list(tmp_path.iterdir()) == []


def test_several_may_ask_at_once(tmp_path: Path) -> None:
    program = [sys.executable, "-m", "biosensor_gateway.cli", "stop", "--timeout", "60"]
    with cli_process(tmp_path, *RUN) as agent:
        wait_until(lambda: pushed(tmp_path) > 0)
        environment = os.environ | {"BIOSENSOR_GATEWAY_STATE": str(tmp_path)}
        askers = [
            subprocess.Popen(program, env=environment, stdout=subprocess.PIPE, text=True)
            for _ in range(2)
        ]
        told = [asker.communicate()[0] for asker in askers]
        assert agent.wait(DEADLINE_S) == 0
    # The slower one may find that there is none any more.
    assert "the agent has ended\n" in told
    assert {asker.returncode for asker in askers} <= {0, 1}
    assert "Traceback" not in said(tmp_path)


def test_an_agent_that_is_still_starting_is_stopped_as_well(tmp_path: Path) -> None:
    with cli_process(tmp_path, *RUN, before=STARTING_TAKES_A_WHILE) as agent:
        wait_until(lambda: is_held(tmp_path))
        assert not (tmp_path / CONTROL_FILE).exists()
        assert stop(tmp_path, "--timeout", "60") == (0, "the agent has ended\n", "")
        assert agent.wait(DEADLINE_S) == 0


@pytest.mark.seam
def test_a_second_agent_is_refused_and_the_first_goes_on(tmp_path: Path) -> None:
    with cli_process(tmp_path, *RUN) as agent:
        wait_until(lambda: pushed(tmp_path) > 0)
        log = (tmp_path / LOG_FILE_NAME).read_text()
        second = command(tmp_path, *RUN)
        assert (second.returncode, second.stdout) == (2, "")
        assert second.stderr.count("\n") == 1
        for words in (str(tmp_path), "biosensor-gateway status", "biosensor-gateway stop"):
            assert words in second.stderr
        assert (tmp_path / LOG_FILE_NAME).read_text() == log
        before = pushed(tmp_path)
        wait_until(lambda: pushed(tmp_path) > before)
        assert status_file.read_status(tmp_path)["process"] == agent.pid
        assert stop(tmp_path)[0] == 0
        assert agent.wait(DEADLINE_S) == 0


def test_a_killed_agent_is_neither_stopped_nor_in_the_way(tmp_path: Path) -> None:
    with cli_process(tmp_path, *RUN) as killed:
        wait_until(lambda: pushed(tmp_path) > 0)
        killed.send_signal(signal.SIGKILL)
        killed.wait()
    assert (tmp_path / CONTROL_FILE).exists()
    assert (tmp_path / LOCK_FILE).exists()
    assert stop(tmp_path) == (1, "", NO_AGENT)
    with cli_process(tmp_path, *RUN) as agent:
        wait_until(lambda: pushed(tmp_path) > 0 and is_held(tmp_path))
        assert stop(tmp_path) == (0, "the agent has ended\n", "")
        assert agent.wait(DEADLINE_S) == 0


def test_an_agent_runs_where_nothing_can_be_written(tmp_path: Path) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    before = f"import os\nos.environ['BIOSENSOR_GATEWAY_STATE'] = {str(in_the_way)!r}"
    with cli_process(tmp_path, *RUN, before=before) as agent:
        wait_until(lambda: visible("zephyr-virtual-ecg"))
        assert stop(in_the_way) == (1, "", NO_AGENT)
        assert agent.poll() is None
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) == 0
    assert said(tmp_path).count("cannot write the lock file") == 1
    assert said(tmp_path).count("`stop` will not work") == 1
    assert "Traceback" not in said(tmp_path)


def test_an_agent_without_a_control_file_runs_and_says_so(tmp_path: Path) -> None:
    (tmp_path / CONTROL_FILE).mkdir()
    with cli_process(tmp_path, *RUN) as agent:
        wait_until(lambda: pushed(tmp_path) > 0)
        code, out, err = stop(tmp_path, "--timeout", "1")
        assert (code, out) == (1, "")
        assert "does not answer" in err
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) == 0
    assert said(tmp_path).count("`stop` will not work") == 1


def test_an_agent_that_hangs_is_said_not_to_answer(tmp_path: Path) -> None:
    with cli_process(tmp_path, *RUN) as agent:
        wait_until(lambda: pushed(tmp_path) > 0)
        agent.send_signal(signal.SIGSTOP)
        code, out, err = stop(tmp_path, "--timeout", "1")
        agent.send_signal(signal.SIGCONT)
        assert (code, out) == (1, "")
        assert err.count("\n") == 1
        assert str(tmp_path) in err
        assert "does not answer" in err


def test_an_agent_that_does_not_end_in_time_is_named(tmp_path: Path) -> None:
    with cli_process(tmp_path, *RUN, before=CLOSING_TAKES_A_MINUTE) as agent:
        wait_until(lambda: pushed(tmp_path) > 0)
        code, out, err = stop(tmp_path, "--timeout", "2")
        assert (code, out) == (1, "")
        assert err.count("\n") == 1
        assert "has not ended within 2 s" in err
        assert str(agent.pid) in err
        assert agent.poll() is None


@pytest.mark.parametrize("is_signalled", [False, True])
def test_an_agent_that_hangs_while_it_closes_ends_all_the_same(
    tmp_path: Path, is_signalled: bool
) -> None:
    with cli_process(tmp_path, *RUN, before=CLOSING_NEVER_ENDS) as agent:
        wait_until(lambda: pushed(tmp_path) > 0)
        if is_signalled:
            agent.terminate()
        else:
            assert stop(tmp_path, "--timeout", "30") == (0, "the agent has ended\n", "")
        # Not as a crash, after which a supervisor would start it again.
        assert agent.wait(DEADLINE_S) == 0
    assert not is_held(tmp_path)


def reply_to(folder: Path, sent: bytes) -> dict[str, Any]:
    port: int = json.loads((folder / CONTROL_FILE).read_text())["port"]
    with socket.create_connection(("127.0.0.1", port), DEADLINE_S) as connection:
        connection.sendall(sent)
        with connection.makefile("rb") as replies:
            return json.loads(replies.read())


def test_nothing_hostile_disturbs_a_running_agent(tmp_path: Path) -> None:
    noise = random.Random(2)
    with cli_process(tmp_path, *RUN, "--verbose") as agent:
        wait_until(lambda: pushed(tmp_path) > 0)
        token: str = json.loads((tmp_path / CONTROL_FILE).read_text())["token"]
        wrong = {"token": token[::-1], "command": "stop"}
        unknown = {"token": token, "command": "fly"}
        attacks = [
            *(noise.randbytes(3000) + b"\n" for _ in range(20)),
            noise.randbytes(1_000_000).replace(b"\n", b"") + b"\n",
            b'{"token": "',
            json.dumps(wrong).encode() + b"\n",
            json.dumps(unknown).encode() + b"\n",
        ]
        replies = [reply_to(tmp_path, attack) for attack in attacks]
        assert [reply["ok"] for reply in replies] == [False] * len(attacks)
        assert f"within {TIME_LIMIT_S:g} s" in replies[-3]["problem"]
        before = pushed(tmp_path)
        wait_until(lambda: pushed(tmp_path) > before)
        (device,) = status_file.read_status(tmp_path)["devices"]
        assert (device["state"], device["connections"]) == ("streaming", 1)
        assert all(counters["lost"] == 0 for counters in device["streams"].values())
        assert stop(tmp_path) == (0, "the agent has ended\n", "")
        assert agent.wait(DEADLINE_S) == 0
    told = said(tmp_path) + (tmp_path / LOG_FILE_NAME).read_text()
    assert "Traceback" not in told
    assert token not in told
    assert not any("error" in line for line in told.splitlines())


@pytest.mark.parametrize("timeout", ["0", "soon"])
def test_a_wrong_timeout_is_a_usage_error(tmp_path: Path, timeout: str) -> None:
    code, _, err = stop(tmp_path, "--timeout", timeout)
    assert code == 2
    assert "--timeout" in err
