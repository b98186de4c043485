"""The real ``systemd-inhibit``, with a stand-in for logind on a private bus."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import AsyncGenerator, Awaitable, Callable, Generator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol, cast

import pytest
from dbus_fast.aio import MessageBus
from dbus_fast.constants import MessageType
from dbus_fast.message import Message
from structlog.testing import capture_logs

from biosensor_gateway.system.keep_awake import KeepAwake, system_inhibitor
from tests.rigs.bluez.private_bus import PrivateBus

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(
        not (shutil.which("dbus-daemon") and shutil.which("systemd-inhibit")),
        reason="dbus-daemon and systemd-inhibit are needed",
    ),
]

Eventually = Callable[[Callable[[], bool]], Awaitable[None]]
StartCli = Callable[..., AbstractContextManager["subprocess.Popen[bytes]"]]

KEPT = "the computer is kept from sleeping while a device streams"
WARNED = "the computer may go to sleep while a device streams"


def events(logs: list[Any]) -> list[str]:
    return [entry["event"].split(";")[0] for entry in logs]


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


def held_until(awake: KeepAwake, logs: list[Any], event: str) -> Callable[[], bool]:
    """Hold until something is logged."""

    def logged() -> bool:
        awake.hold(True)
        return event in events(logs)

    return logged


async def test_systemd_inhibit_understands_what_it_is_told(
    login: Login, awake: KeepAwake, eventually: Eventually
) -> None:
    with capture_logs() as logs:
        await eventually(held_until(awake, logs, KEPT))
        assert login.locked
        awake.close()
        await eventually(lambda: not login.locked)
    assert login.asked == [["sleep:idle", "Biosensor Gateway", "a biosensor is streaming", "block"]]


async def test_a_refusal_of_logind_is_quoted(
    login: Login, awake: KeepAwake, eventually: Eventually
) -> None:
    login.refuses = True
    with capture_logs() as logs:
        await eventually(held_until(awake, logs, WARNED))
    assert events(logs) == [WARNED]
    assert logs[0]["error"] == "Failed to inhibit: Access denied"


async def test_the_lock_ends_with_an_agent_that_is_killed(
    login: Login, cli_process: StartCli, eventually: Eventually, tmp_path: Path
) -> None:
    with cli_process(tmp_path, "run", "--simulate", "zephyr") as agent:
        await eventually(lambda: KEPT in (tmp_path / "stderr.txt").read_text())
        assert login.locked
        agent.kill()
        await eventually(lambda: not login.locked)
