"""Serial ports, on pseudo-terminals: bytes, stamps, hang-ups, and an end in every case."""

from __future__ import annotations

import asyncio
import errno
import os
import subprocess
import sys
import threading
from collections.abc import AsyncGenerator, Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol

import pytest
import serial
from pylsl import local_clock

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.process_limits import raise_limit
from biosensor_gateway.transports import serial_port as module
from biosensor_gateway.transports.serial_port import SerialLink
from tests.rigs.polling import eventually

pytestmark = pytest.mark.nightly

ALL_BYTES = bytes(range(256))
CLOSED_WITHIN_S = 20.0
HOLD_PORT = """
import serial, sys
port = serial.Serial(sys.argv[1], exclusive=True)
print("held", flush=True)
sys.stdin.read()
"""


class Pty(Protocol):
    master: int
    port: str

    def heard(self) -> bytes: ...
    def hang_up(self) -> None: ...


@pytest.fixture(autouse=True)
async def no_thread_is_left() -> AsyncGenerator[None]:
    before = set(threading.enumerate())
    yield
    await eventually(lambda: set(threading.enumerate()) <= before)


@pytest.fixture
async def link(pty: Pty) -> AsyncGenerator[SerialLink]:
    opened = SerialLink(pty.port)
    await opened.open()
    yield opened
    await close(opened)


async def close(link: SerialLink) -> None:
    await asyncio.wait_for(link.close(), CLOSED_WITHIN_S)


async def receive(link: SerialLink, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += (await link.read()).data
    return data


async def open_error(port: str) -> TransportError:
    link = SerialLink(port)
    with pytest.raises(TransportError) as caught:
        await link.open()
    await close(link)
    assert port in str(caught.value)
    return caught.value


@pytest.mark.seam
async def test_every_byte_value_passes_both_ways(pty: Pty, link: SerialLink) -> None:
    os.write(pty.master, ALL_BYTES)
    assert await receive(link, 256) == ALL_BYTES
    heard = bytearray()
    for value in ALL_BYTES:
        link.write(bytes([value]))

    def all_heard() -> bool:
        heard.extend(pty.heard())
        return len(heard) >= 256

    await eventually(all_heard)
    assert bytes(heard) == ALL_BYTES


@pytest.mark.nightly
async def test_what_was_written_before_closing_is_sent(pty: Pty, link: SerialLink) -> None:
    link.write(b"stop, ")
    link.write(b"please")
    await close(link)
    assert pty.heard() == b"stop, please"


@pytest.mark.nightly
async def test_bytes_carry_the_lsl_time_of_their_arrival(pty: Pty, link: SerialLink) -> None:
    before = local_clock()
    os.write(pty.master, b"x")
    # Read later: the stamp is that of the arrival, not of the reading.
    await asyncio.sleep(2.0)
    after = local_clock()
    data, arrival = await link.read()
    assert data == b"x"
    assert before <= arrival < after - 0.5


@pytest.mark.nightly
async def test_a_port_that_is_not_there_is_absent(tmp_path: Path) -> None:
    error = await open_error(str(tmp_path / "ttyUSB9"))
    assert error.reason is TransportReason.ABSENT
    assert "no such port" in str(error)


@pytest.mark.nightly
async def test_a_file_that_is_no_port_is_not_called_missing(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.touch()
    error = await open_error(str(path))
    assert "cannot be opened" in str(error)
    assert "no such port" not in str(error)


@contextmanager
def held_by_another_program(port: str) -> Generator[None]:
    command = [sys.executable, "-c", HOLD_PORT, port]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        yield


@pytest.mark.nightly
async def test_a_port_that_another_program_holds_is_busy(pty: Pty) -> None:
    with held_by_another_program(pty.port):
        error = await open_error(pty.port)
    assert error.reason is TransportReason.BUSY
    assert "another program" in str(error)
    link = SerialLink(pty.port)
    await link.open()
    await close(link)


def windows_error(cause: str) -> serial.SerialException:
    return serial.SerialException(f"could not open port 'COM3': {cause}")


@pytest.mark.parametrize(
    ("raised", "reason", "words"),
    [
        # Root is refused nothing, and no test has a radio or Windows.
        (serial.SerialException(errno.EACCES, "x"), TransportReason.DENIED, "dialout"),
        (serial.SerialException(errno.EPERM, "x"), TransportReason.DENIED, "dialout"),
        (serial.SerialException(errno.EBUSY, "x"), TransportReason.BUSY, "another program"),
        (serial.SerialException(errno.EHOSTDOWN, "x"), TransportReason.ABSENT, "switch it on"),
        (serial.SerialException(errno.ENXIO, "x"), TransportReason.ABSENT, "gone"),
        (OSError(errno.ECONNREFUSED, "x"), TransportReason.ABSENT, "refuses"),
        (OSError(errno.EISDIR, "a folder"), TransportReason.ABSENT, "a folder"),
        (ValueError("not a port"), TransportReason.ABSENT, "not a usable port name"),
        (
            serial.SerialException(
                "could not open port 'COM3': FileNotFoundError(2, 'x', None, 2)"
            ),
            TransportReason.ABSENT,
            "no such port",
        ),
        (
            windows_error("PermissionError(13, 'x', None, 5)"),
            TransportReason.BUSY,
            "another program",
        ),
        (
            windows_error("OSError(22, 'x', None, 121)"),
            TransportReason.ABSENT,
            "switch it on",
        ),
        (
            windows_error("OSError(22, 'x', None, 31)"),
            TransportReason.ABSENT,
            "None, 31",
        ),
    ],
)
async def test_what_the_system_says_becomes_a_reason_and_an_advice(
    monkeypatch: pytest.MonkeyPatch, raised: Exception, reason: TransportReason, words: str
) -> None:
    def refuse(*_arguments: Any, **_options: Any) -> None:
        raise raised

    monkeypatch.setattr(module, "Port", refuse)
    error = await open_error("COM3")
    assert error.reason is reason
    assert words in str(error)


@pytest.fixture
def slow_port(monkeypatch: pytest.MonkeyPatch) -> Generator[threading.Event]:
    """Ports open only once the event is set."""
    may_open = threading.Event()
    at_once = module.Port

    def slow(*arguments: Any, **options: Any) -> serial.Serial:
        may_open.wait(CLOSED_WITHIN_S)
        return at_once(*arguments, **options)

    monkeypatch.setattr(module, "Port", slow)
    yield may_open
    may_open.set()


@pytest.mark.seam
@pytest.mark.skipif(sys.platform != "linux", reason="other systems wait by select")
async def test_a_port_opened_beside_a_thousand_files_is_read_and_written(pty: Pty) -> None:
    # select takes no descriptor above 1023, and each stream takes some.
    raise_limit()
    with ExitStack() as stack:
        while (held := os.open(os.devnull, os.O_RDONLY)) < 1024:
            stack.callback(os.close, held)
        stack.callback(os.close, held)
        link = SerialLink(pty.port)
        await link.open()
    os.write(pty.master, ALL_BYTES)
    assert await receive(link, 256) == ALL_BYTES
    link.write(ALL_BYTES)
    heard = bytearray()

    def has_heard_all() -> bool:
        heard.extend(pty.heard())
        return bytes(heard) == ALL_BYTES

    await eventually(has_heard_all)
    await close(link)


async def is_free(port: str) -> bool:
    link = SerialLink(port)
    try:
        await link.open()
    except TransportError:
        return False
    finally:
        await close(link)
    return True


@pytest.mark.nightly
async def test_a_port_that_does_not_open_in_time_is_absent_and_not_held_later(
    pty: Pty, slow_port: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "OPEN_TIMEOUT_S", 0.05)
    before = threading.active_count()
    error = await open_error(pty.port)
    assert error.reason is TransportReason.ABSENT
    assert "is the device on" in str(error)
    slow_port.set()
    await eventually(lambda: threading.active_count() <= before)
    monkeypatch.undo()
    assert await is_free(pty.port)


@pytest.mark.nightly
@pytest.mark.parametrize("opened_before_the_stop", [False, True])
async def test_a_stop_while_opening_leaves_no_port_open(
    pty: Pty,
    slow_port: threading.Event,
    monkeypatch: pytest.MonkeyPatch,
    opened_before_the_stop: bool,
) -> None:
    before = threading.active_count()
    link = SerialLink(pty.port)
    opening = asyncio.create_task(link.open())
    await asyncio.sleep(0.01)
    if opened_before_the_stop:
        # The loop stands still, so the port is open before it learns of that.
        slow_port.set()
        while threading.active_count() > before:
            pass
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening
    await close(link)
    slow_port.set()
    await eventually(lambda: threading.active_count() <= before)
    monkeypatch.undo()
    assert await is_free(pty.port)


@pytest.mark.seam
async def test_a_hang_up_is_told_after_everything_that_had_arrived(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = bytearray()
    read = module.Port.read

    def noted(port: Any, size: int = 1) -> bytes:
        data = read(port, size)
        taken.extend(data)
        return data

    monkeypatch.setattr(module.Port, "read", noted)
    link = SerialLink(pty.port)
    await link.open()
    os.write(pty.master, ALL_BYTES)
    # A pseudo-terminal forgets what nobody had taken when it hangs up.
    await eventually(lambda: len(taken) == 256)
    pty.hang_up()
    assert await receive(link, 256) == ALL_BYTES
    for _ in range(2):
        with pytest.raises(TransportError, match="link was cut") as caught:
            await link.read()
        assert caught.value.reason is TransportReason.LOST
    await close(link)


@pytest.mark.nightly
async def test_a_hang_up_between_two_reads_loses_no_byte(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hung_up(_port: serial.Serial) -> int:
        raise OSError(errno.EIO, "input/output error")

    monkeypatch.setattr(serial.Serial, "in_waiting", property(hung_up))
    link = SerialLink(pty.port)
    await link.open()
    os.write(pty.master, b"!")
    assert (await link.read()).data == b"!"
    with pytest.raises(TransportError) as caught:
        await link.read()
    assert caught.value.reason is TransportReason.LOST
    await close(link)


@pytest.mark.nightly
async def test_a_hang_up_ends_a_waiting_read(pty: Pty, link: SerialLink) -> None:
    reading = asyncio.create_task(link.read())
    await asyncio.sleep(0.05)
    pty.hang_up()
    with pytest.raises(TransportError):
        await asyncio.wait_for(reading, CLOSED_WITHIN_S)


@pytest.mark.nightly
async def test_a_write_that_nobody_takes_ends_the_link(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "WRITE_TIMEOUT_S", 0.1)
    link = SerialLink(pty.port)
    await link.open()
    link.write(bytes(200_000))
    with pytest.raises(TransportError) as caught:
        await asyncio.wait_for(link.read(), CLOSED_WITHIN_S)
    assert caught.value.reason is TransportReason.LOST
    await close(link)


@pytest.mark.nightly
async def test_closing_does_not_wait_for_a_write_that_nobody_takes(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "WRITE_TIMEOUT_S", 2 * CLOSED_WITHIN_S)
    monkeypatch.setattr(module, "CLOSE_TIMEOUT_S", 0.1)
    before = threading.active_count()
    link = SerialLink(pty.port)
    await link.open()
    link.write(bytes(200_000))
    await eventually(lambda: bool(pty.heard()))
    await close(link)
    assert threading.active_count() > before
    pty.hang_up()


@pytest.mark.nightly
async def test_a_link_can_be_closed_in_every_state(pty: Pty) -> None:
    never_opened = SerialLink(pty.port)
    await close(never_opened)
    link = SerialLink(pty.port)
    await link.open()
    await close(link)
    await close(link)
    after_a_loss = SerialLink(pty.port)
    await after_a_loss.open()
    pty.hang_up()
    with pytest.raises(TransportError):
        await after_a_loss.read()
    await close(after_a_loss)


@pytest.mark.nightly
async def test_a_closed_port_is_free_at_once(pty: Pty) -> None:
    for _ in range(20):
        link = SerialLink(pty.port)
        await link.open()
        link.write(b"x")
        await close(link)


@pytest.mark.nightly
async def test_a_read_that_the_system_aborts_is_the_end_of_the_link(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    ports: list[serial.Serial] = []

    def opened(*arguments: Any, **options: Any) -> serial.Serial:
        ports.append(make(*arguments, **options))
        return ports[0]

    make = serial.Serial
    monkeypatch.setattr(module, "Port", opened)
    link = SerialLink(pty.port)
    await link.open()
    # What Windows does to a pending read when a device is pulled out.
    ports[0].cancel_read()
    with pytest.raises(TransportError) as caught:
        await asyncio.wait_for(link.read(), CLOSED_WITHIN_S)
    assert caught.value.reason is TransportReason.LOST
    await close(link)
