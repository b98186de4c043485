"""When and by which program the computer is kept awake, and what is said of it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator
from pathlib import Path
from typing import Any, Protocol, cast

import pytest
from dbus_fast.aio import MessageBus
from dbus_fast.constants import MessageType
from dbus_fast.message import Message
from structlog.testing import capture_logs

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from biosensor_gateway.system.keep_awake import (
    GRACE_S,
    RETRY_S,
    Inhibitor,
    KeepAwake,
    system_inhibitor,
)
from tests.rigs.bluez.private_bus import PrivateBus
from tests.rigs.gateway import cli_process
from tests.rigs.polling import eventually, wait_until
from tests.rigs.virtual_time import SetClock

# When the computer is kept awake, and what is said of it.

KEPT = "the computer is kept from sleeping while a device streams"
LET_GO = "the computer may go to sleep again"
WARNED = "the computer may go to sleep while a device streams"


class Recorder:
    """A system that writes down what is asked of it."""

    way = "recorder"

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.refusal: OSError | None = None
        self.agreed = True

    def begin(self) -> None:
        self.calls.append("begin")
        if self.refusal:
            raise self.refusal

    def held(self) -> bool:
        if self.refusal:
            raise self.refusal
        return self.agreed

    def end(self) -> None:
        self.calls.append("end")


def events(logs: list[Any]) -> list[str]:
    return [entry["event"].split(";")[0] for entry in logs]


def every_second(awake: KeepAwake, clock: SetClock, seconds: float, *, wanted: bool) -> None:
    end = clock.now_s + seconds
    while clock.now_s < end:
        awake.hold(wanted)
        clock.now_s += 1.0


def test_it_is_held_once_and_let_go_once_a_grace_period_after_the_last_stream() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    with capture_logs() as logs:
        every_second(awake, clock, 10, wanted=False)
        assert system.calls == []
        every_second(awake, clock, 600, wanted=True)
        # The last stream was seen a second ago.
        every_second(awake, clock, GRACE_S - 1, wanted=False)
        assert system.calls == ["begin"]
        every_second(awake, clock, 600, wanted=False)
        assert system.calls == ["begin", "end"]
        awake.close()
    assert system.calls == ["begin", "end"]
    assert [(entry["event"], entry["log_level"]) for entry in logs] == [
        (KEPT, "info"),
        (LET_GO, "info"),
    ]


def test_a_device_that_drops_out_for_less_is_no_end() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    for _ in range(5):
        every_second(awake, clock, 5, wanted=True)
        every_second(awake, clock, GRACE_S - 2, wanted=False)
    assert system.calls == ["begin"]


def test_closing_ends_it_without_a_grace_period_and_it_can_be_held_again() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    awake.hold(True)
    awake.close()
    awake.hold(False)
    assert system.calls == ["begin", "end"]
    awake.hold(True)
    assert system.calls == ["begin", "end", "begin"]


def test_after_a_long_sleep_it_is_asked_for_again() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    awake.hold(True)
    clock.now_s += GRACE_S
    awake.hold(True)
    assert system.calls == ["begin", "end", "begin"]


def test_a_refusal_is_said_once_and_the_system_is_asked_again_after_a_while() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    system.refusal = PermissionError("not you")
    with capture_logs() as logs:
        every_second(awake, clock, 3 * RETRY_S, wanted=True)
        assert system.calls == ["begin", "end"] * 3
        (warning,) = logs
        system.refusal = None
        every_second(awake, clock, RETRY_S, wanted=True)
    assert (warning["log_level"], warning["error"]) == ("warning", "not you")
    assert events(logs) == [WARNED, KEPT]
    assert system.calls[-1] == "begin"


def test_it_is_not_said_to_be_held_before_the_system_has_agreed() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    system.agreed = False
    with capture_logs() as logs:
        every_second(awake, clock, 5, wanted=True)
        assert logs == []
        system.agreed = True
        every_second(awake, clock, 5, wanted=True)
    assert system.calls == ["begin"]
    assert events(logs) == [KEPT]


# By which program the computer is kept awake, and that it always ends.
ENDED_WITHIN_S = 15.0
NOTHING = "nothing on this computer can prevent sleep"
# Both run something that they outlive, as the real ones do.
STAND_INS = {
    "systemd-inhibit": """\
while [ "${1#--}" != "$1" ]; do shift; done
"$@" """,
    "caffeinate": """\
while kill -0 "$3"; do sleep 0.05; done 2>/dev/null""",
}
ARGUMENTS = {
    "systemd-inhibit": "--what=sleep:idle --mode=block --who=Biosensor Gateway "
    f"--why=a biosensor is streaming {shutil.which('cat')}",
    "caffeinate": f"-i -w {os.getpid()}",
}
PLATFORMS = {"linux": "systemd-inhibit", "darwin": "caffeinate"}
BOTH = pytest.mark.parametrize("platform", PLATFORMS)


class Programs:
    """A folder of stand-ins, and what was written down there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._calls = folder / "calls"
        for name, work in STAND_INS.items():
            self.write(name, work)

    def write(self, name: str, work: str) -> None:
        program = self._folder / name
        program.write_text(
            f'#!/bin/sh\necho "called $$ $*" >>{self._calls}\n{work}\n'
            f"code=$?; echo released >>{self._calls}; exit $code\n"
        )
        program.chmod(0o755)

    @property
    def calls(self) -> list[str]:
        """One line a call, ``called PID ARGUMENTS``, and one when its work ended by itself."""
        return self._calls.read_text().splitlines() if self._calls.exists() else []

    @property
    def process(self) -> int:
        return int(self.calls[0].split()[1])


def is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Programs:
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    # The stand-ins do not connect to it.
    monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", f"unix:path={folder / 'bus'}")
    return Programs(folder)


@pytest.fixture
def keep_awake() -> Generator[Callable[[Inhibitor | None], KeepAwake]]:
    made: list[KeepAwake] = []

    def make(inhibitor: Inhibitor | None) -> KeepAwake:
        made.append(KeepAwake(inhibitor))
        return made[-1]

    yield make
    for each in made:
        each.close()


MakeKeepAwake = Callable[[Inhibitor | None], KeepAwake]


def held_until(awake: KeepAwake, logs: list[Any], event: str) -> Callable[[], bool]:
    """Hold until something is logged."""

    def logged() -> bool:
        awake.hold(True)
        return event in events(logs)

    return logged


@pytest.mark.seam
@BOTH
def test_the_program_runs_while_it_is_held_and_not_longer(
    programs: Programs, keep_awake: MakeKeepAwake, platform: str
) -> None:
    awake = keep_awake(system_inhibitor(platform))
    with capture_logs() as logs:
        wait_until(held_until(awake, logs, KEPT))
        wait_until(lambda: programs.calls != [])
        awake.hold(True)
        assert is_running(programs.process)
        # Ctrl-C goes to the group of the agent.
        assert os.getpgid(programs.process) != os.getpgid(0)
        awake.close()
        assert not is_running(programs.process)
    (call,) = programs.calls
    assert call.split(maxsplit=2)[2] == ARGUMENTS[PLATFORMS[platform]]
    assert events(logs) == [KEPT, LET_GO]
    assert logs[0]["way"] == PLATFORMS[platform]


@pytest.mark.nightly
@BOTH
def test_a_program_that_refuses_is_quoted(
    programs: Programs, keep_awake: MakeKeepAwake, platform: str
) -> None:
    programs.write(PLATFORMS[platform], "echo; echo 'Failed: Access denied' >&2; echo >&2; false")
    awake = keep_awake(system_inhibitor(platform))
    with capture_logs() as logs:
        wait_until(held_until(awake, logs, WARNED))
    assert logs[-1]["error"] == "Failed: Access denied"
    assert len(programs.calls) == 2


@pytest.mark.nightly
def test_a_program_that_is_killed_is_noticed(programs: Programs, keep_awake: MakeKeepAwake) -> None:
    awake = keep_awake(system_inhibitor("linux"))
    with capture_logs() as logs:
        wait_until(held_until(awake, logs, KEPT))
        os.kill(programs.process, signal.SIGKILL)
        wait_until(held_until(awake, logs, WARNED))
    assert logs[-1]["error"] == "it ended unexpectedly"


@pytest.mark.nightly
def test_a_program_that_cannot_be_started_is_a_refusal(
    programs: Programs, keep_awake: MakeKeepAwake, tmp_path: Path
) -> None:
    awake = keep_awake(system_inhibitor("linux"))
    (tmp_path / "bin" / "systemd-inhibit").unlink()
    with capture_logs() as logs:
        awake.hold(True)
        awake.hold(True)
    assert events(logs) == [WARNED]
    assert programs.calls == []


@BOTH
def test_where_there_is_no_such_program_nobody_is_bothered(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, platform: str
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with capture_logs() as logs:
        inhibitor = system_inhibitor(platform)
        KeepAwake(inhibitor).hold(True)
    assert inhibitor is None
    assert [(entry["event"], entry["log_level"]) for entry in logs] == [(NOTHING, "debug")]


def test_a_container_without_a_system_bus_has_nobody_to_ask(
    programs: Programs, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("DBUS_SYSTEM_BUS_ADDRESS")
    monkeypatch.setattr("biosensor_gateway.system.keep_awake._BUS_SOCKET", tmp_path / "bus")
    assert system_inhibitor("linux") is None
    (tmp_path / "bus").touch()
    assert system_inhibitor("linux") is not None
    assert programs.calls == []


HOLDS = """
from biosensor_gateway.system.keep_awake import KeepAwake, system_inhibitor
import sys, time
awake = KeepAwake(system_inhibitor(sys.argv[1]))
while True:
    awake.hold(True)
    time.sleep(0.1)
"""


@pytest.mark.nightly
@BOTH
def test_the_program_ends_with_a_process_that_is_killed(programs: Programs, platform: str) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLDS, platform]) as holder:
        try:
            wait_until(lambda: programs.calls != [])
            process = programs.process
            assert is_running(process)
        finally:
            holder.kill()
    wait_until(lambda: programs.calls[-1] == "released")
    wait_until(lambda: not is_running(process))


def device_state(folder: Path) -> tuple[str, float]:
    """State of the only device of a running agent, and when the agent reported it."""
    try:
        status = status_file.read_status(folder)
    except ConfigError:
        return "", 0.0
    return status["devices"][0]["state"], status["written"]


def reports(folder: Path, state: str) -> None:
    """Wait for three of the agent's reports with the device in that state."""
    seen: set[float] = set()

    def enough() -> bool:
        now, written = device_state(folder)
        if now == state:
            seen.add(written)
        return len(seen) >= 3

    wait_until(enough)


needs_linux = pytest.mark.skipif(
    sys.platform != "linux", reason="the stand-in is the program of Linux"
)
needs_systemd = pytest.mark.skipif(
    not (shutil.which("dbus-daemon") and shutil.which("systemd-inhibit")),
    reason="dbus-daemon and systemd-inhibit are needed",
)


@pytest.mark.nightly
@needs_linux
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_an_agent_that_streams_keeps_the_computer_awake_until_it_ends(
    programs: Programs, tmp_path: Path, number: signal.Signals
) -> None:
    with cli_process(tmp_path, "run", "--simulate", "zephyr") as agent:
        wait_until(lambda: KEPT in (tmp_path / "stderr.txt").read_text())
        reports(tmp_path, "streaming")
        assert is_running(programs.process)
        agent.send_signal(number)
        assert agent.wait(ENDED_WITHIN_S) in {0, -signal.SIGKILL}
    wait_until(lambda: not is_running(programs.process))
    told = (tmp_path / "stderr.txt").read_text()
    assert len([call for call in programs.calls if call.startswith("called")]) == 1
    assert told.count(KEPT) == 1
    assert told.count(LET_GO) == (1 if number == signal.SIGTERM else 0)


@pytest.mark.nightly
@needs_linux
def test_an_agent_whose_device_is_absent_keeps_nothing_awake(
    programs: Programs, tmp_path: Path
) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text(f'[[device]]\nsensor = "zephyr"\nunit = "1"\nport = "{tmp_path}/tty"\n')
    with cli_process(tmp_path, "run", "--settings", str(settings)):
        reports(tmp_path, "discovering")
    assert programs.calls == []


@pytest.mark.nightly
@needs_linux
def test_the_settings_switch_it_off(
    programs: Programs,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_POWER__KEEP_AWAKE", "false")
    with cli_process(tmp_path, "run", "--simulate", "zephyr"):
        reports(tmp_path, "streaming")
    assert programs.calls == []


class _Bus(Protocol):
    """What is used of the bus, whose annotation leaves a type argument out."""

    def send(self, msg: Message) -> Awaitable[object]: ...


class Login:
    """A stand-in for logind that gives out inhibitor locks, or refuses to."""

    def __init__(self, bus: MessageBus) -> None:
        self._bus = cast("_Bus", bus)
        self.refuses = False
        self.asked: list[list[str]] = []
        self._locks: list[int] = []
        self._sent: list[tuple[Awaitable[object], int]] = []
        bus.add_message_handler(self._on_message)

    @property
    def locked(self) -> bool:
        """Whether anybody has a lock: its pipe has another end."""
        return any(not self._is_hung_up(lock) for lock in self._locks)

    @staticmethod
    def _is_hung_up(lock: int) -> bool:
        try:
            return os.read(lock, 1) == b""
        except BlockingIOError:
            return False

    def _on_message(self, message: Message) -> bool | None:
        if (message.message_type, message.member) != (MessageType.METHOD_CALL, "Inhibit"):
            return None
        self.asked.append(message.body)
        if self.refuses:
            name = "org.freedesktop.DBus.Error.AccessDenied"
            self._bus.send(Message.new_error(message, name, "Permission denied"))
            return True
        lock, theirs = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._locks.append(lock)
        answer = Message.new_method_return(message, "h", [0], unix_fds=[theirs])
        sending = self._bus.send(answer)
        # Once it is sent, the only copy is the asker's.
        cast("Any", sending).add_done_callback(lambda _done: os.close(theirs))  # pyright: ignore[reportUnknownLambdaType, reportUnknownArgumentType]
        return True

    def close(self) -> None:
        for lock in self._locks:
            os.close(lock)


@pytest.fixture
async def login(monkeypatch: pytest.MonkeyPatch) -> AsyncGenerator[Login]:
    with PrivateBus() as private_bus:
        monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", private_bus.address)
        bus = await MessageBus(bus_address=private_bus.address, negotiate_unix_fd=True).connect()
        await bus.request_name("org.freedesktop.login1")
        login = Login(bus)
        yield login
        login.close()
        bus.disconnect()
        await bus.wait_for_disconnect()


@pytest.fixture
def awake(login: Login) -> Generator[KeepAwake]:
    del login
    supervisor = KeepAwake(system_inhibitor("linux"))
    yield supervisor
    supervisor.close()


@pytest.mark.nightly
@needs_systemd
async def test_systemd_inhibit_understands_what_it_is_told(login: Login, awake: KeepAwake) -> None:
    with capture_logs() as logs:
        await eventually(held_until(awake, logs, KEPT))
        assert login.locked
        awake.close()
        await eventually(lambda: not login.locked)
    assert login.asked == [["sleep:idle", "Biosensor Gateway", "a biosensor is streaming", "block"]]


@pytest.mark.nightly
@needs_systemd
async def test_a_refusal_of_logind_is_quoted(login: Login, awake: KeepAwake) -> None:
    login.refuses = True
    with capture_logs() as logs:
        await eventually(held_until(awake, logs, WARNED))
    assert events(logs) == [WARNED]
    assert logs[0]["error"] == "Failed to inhibit: Access denied"


@pytest.mark.nightly
@needs_systemd
async def test_the_lock_ends_with_an_agent_that_is_killed(login: Login, tmp_path: Path) -> None:
    with cli_process(tmp_path, "run", "--simulate", "zephyr") as agent:
        await eventually(lambda: KEPT in (tmp_path / "stderr.txt").read_text())
        assert login.locked
        agent.kill()
        await eventually(lambda: not login.locked)
