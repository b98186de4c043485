"""Lists, reads and writes serial ports, including Bluetooth ones."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import re
import select
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import serial

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports import bluez
from biosensor_gateway.transports.link import Received
from biosensor_gateway.transports.nearby import SerialPort
from biosensor_gateway.transports.threads import Traffic, in_daemon_thread

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer as Buffer

USUAL_BAUD_RATE = 115200
OPEN_TIMEOUT_S = 20.0
# On Windows a write to a vanished Bluetooth port would wait forever.
WRITE_TIMEOUT_S = 2.0
CLOSE_TIMEOUT_S = 1.0
# A read that was not yet on its way when it was cancelled is cancelled again after this time.
_CANCEL_AGAIN_S = 0.02
# pyserial raises these, too, when a port is closed under a blocked call.
_PORT_ERRORS = (OSError, TypeError, ValueError, AttributeError)
# On Windows pyserial has the system's error only in its text, as the last number of a repr.
_WINDOWS_CODE = re.compile(r", None, (\d+)\)")
_WINDOWS_ERRNOS = {2: errno.ENOENT, 5: errno.EBUSY, 121: errno.ETIMEDOUT, 1168: errno.ENXIO}
_OPEN_REASONS: dict[int | None, tuple[TransportReason, str]] = {
    errno.ENOENT: (TransportReason.ABSENT, "there is no such port; pair or plug in the device"),
    errno.ENODEV: (TransportReason.ABSENT, "there is no such port; pair or plug in the device"),
    errno.ENXIO: (TransportReason.ABSENT, "the device behind the port is gone"),
    errno.EIO: (TransportReason.ABSENT, "the device behind the port is gone"),
    errno.EHOSTDOWN: (TransportReason.ABSENT, "the device does not answer; switch it on"),
    errno.ETIMEDOUT: (TransportReason.ABSENT, "the device does not answer; switch it on"),
    errno.ECONNREFUSED: (TransportReason.ABSENT, "the device refuses; switch it off and on"),
    errno.EBUSY: (TransportReason.BUSY, "another program is using the port; close it there"),
    errno.EAGAIN: (TransportReason.BUSY, "another program is using the port; close it there"),
    errno.EACCES: (TransportReason.DENIED, "no permission; add yourself to the group dialout"),
    errno.EPERM: (TransportReason.DENIED, "no permission; add yourself to the group dialout"),
}


class _PolledPort(serial.Serial):
    """Serial port that waits with poll on Linux, because select accepts descriptors up to 1023.

    An agent with some 60 streams has more than that, so pyserial's own port could not be read.
    """

    def read(self, size: int = 1, /) -> bytes:
        """Read *size* bytes without a time limit; fewer only if the read is cancelled."""
        handle, cancelled, data = self.fileno(), self.pipe_abort_read_r, bytearray()
        if cancelled is None:
            raise serial.PortNotOpenError
        while len(data) < size:
            if cancelled in _ready({handle: select.POLLIN, cancelled: select.POLLIN}):
                os.read(cancelled, 1000)
                break
            with contextlib.suppress(BlockingIOError):
                part = os.read(handle, size - len(data))
                if not part:
                    raise serial.SerialException("the device is gone")
                data += part
        return bytes(data)

    def write(self, b: Buffer, /) -> int:
        """Write all bytes within the port's time limit."""
        handle, rest = self.fileno(), memoryview(b)
        total, deadline_s = len(rest), LSL_CLOCK() + WRITE_TIMEOUT_S
        while rest:
            with contextlib.suppress(BlockingIOError):
                rest = rest[os.write(handle, rest) :]
            if rest and not _ready({handle: select.POLLOUT}, deadline_s - LSL_CLOCK()):
                raise serial.SerialTimeoutException("the device accepts no data")
        return total


def _ready(events: dict[int, int], limit_s: float | None = None) -> set[int]:
    """Wait for an event on a descriptor; return the ready descriptors."""
    poll = select.poll()
    for descriptor, event in events.items():
        poll.register(descriptor, event)
    limit_ms = None if limit_s is None else max(0.0, 1000 * limit_s)
    return {descriptor for descriptor, _ in poll.poll(limit_ms)}


Port = _PolledPort if sys.platform == "linux" else serial.Serial


class SerialLink:
    """A serial port as a :class:`~biosensor_gateway.transports.link.ByteLink`."""

    def __init__(self, port: str, baudrate: int = USUAL_BAUD_RATE) -> None:
        self._name = port
        self._baudrate = baudrate
        self._port: serial.Serial | None = None
        self._traffic = Traffic(port, "is the device on and near?")

    async def open(self) -> None:
        """Open the port; see :class:`~biosensor_gateway.transports.link.ByteLink`."""
        try:
            async with asyncio.timeout(OPEN_TIMEOUT_S):
                port = await in_daemon_thread(self._open_port)
        except TimeoutError as error:
            self._traffic.closing = True
            message = f"{self._name}: opening takes over {OPEN_TIMEOUT_S:.0f} s; is the device on?"
            raise TransportError(TransportReason.ABSENT, message) from error
        except OSError as error:
            raise self._open_error(error) from error
        except ValueError as error:
            message = f"{self._name}: not a usable port name ({error})"
            raise TransportError(TransportReason.ABSENT, message) from error
        self._traffic.start(lambda: self._read_forever(port), lambda: self._write_forever(port))

    async def read(self) -> Received:
        """Wait for the next bytes; raise ``LOST`` if the port is gone."""
        return await self._traffic.read()

    def write(self, data: bytes) -> None:
        """Queue bytes for the writing thread."""
        self._traffic.write(data)

    async def close(self) -> None:
        """Send the queued bytes, then close the port."""
        self._traffic.closing = True
        self._traffic.end_writing()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await in_daemon_thread(self._end)

    def _end(self) -> None:
        if self._traffic.started:
            self._traffic.join_writer(CLOSE_TIMEOUT_S)
        elif self._port is not None:
            # It was opened when whoever asked for it had gone.
            self._port.close()

    def _open_port(self) -> serial.Serial:
        port = Port(
            self._name,
            self._baudrate,
            timeout=None,
            write_timeout=WRITE_TIMEOUT_S,
            exclusive=True,
        )
        self._port = port
        if self._traffic.closing:
            # Nobody waits for it any more; held open, it would refuse the next attempt.
            port.close()
        return port

    def _open_error(self, error: OSError) -> TransportError:
        unknown = (TransportReason.ABSENT, f"it cannot be opened ({error})")
        reason, advice = _OPEN_REASONS.get(_error_code(error), unknown)
        return TransportError(reason, f"{self._name}: {advice}")

    def _read_forever(self, port: serial.Serial) -> None:
        try:
            while not self._traffic.closing:
                data, arrival = port.read(1), LSL_CLOCK()
                if not data and not self._traffic.closing:
                    # It has no time limit: Windows ends it when the device is pulled out.
                    raise serial.SerialException("the system ended the read")
                try:
                    waiting = port.in_waiting
                    # Not earlier: what comes while this thread waits for its turn would be
                    # stamped before it was sent, and the device's clock follows the earliest.
                    arrival = LSL_CLOCK()
                    data += port.read(waiting)
                finally:
                    # Also when the link is cut between the two calls.
                    if data:
                        self._traffic.deliver(data, arrival)
        except _PORT_ERRORS as error:
            self._traffic.lost(error)

    def _write_forever(self, port: serial.Serial) -> None:
        try:
            for data in self._traffic.outgoing():
                port.write(data)
        except _PORT_ERRORS as error:
            self._traffic.lost(error)
        try:
            self._end_reading(port)
            port.close()
        except _PORT_ERRORS as error:
            self._traffic.lost(error)

    def _end_reading(self, port: serial.Serial) -> None:
        """End the reading thread; the port is not closed before, however long that takes.

        Windows writes the result of a read to memory of pyserial that closing frees.
        """
        self._traffic.closing = True
        port.cancel_read()
        while not self._traffic.join_reader(_CANCEL_AGAIN_S):
            port.cancel_read()


def _error_code(error: OSError) -> int | None:
    if error.errno is not None:
        return error.errno
    found = _WINDOWS_CODE.search(str(error))
    return _WINDOWS_ERRNOS.get(int(found[1])) if found else None


SERIAL_PORT_SERVICE = "00001101-0000-1000-8000-00805f9b34fb"
# BTHENUM\{00001101-0000-...}_LOCALMFG&0000\7&23456789&0&000666AABBCC_C00000000, and for a port
# that waits for a caller ...&0&000000000000_00000000
_WINDOWS_BLUETOOTH = re.compile(r"BTHENUM\\\{00001101-.*&([0-9A-F]{12})_", re.IGNORECASE)
_INCOMING = "000000000000"


async def serial_ports() -> list[SerialPort]:
    """List the ports that a driver can open; never raises.

    On Linux, paired Bluetooth devices with a serial service are listed by their address, which a
    driver can open as well.
    """
    if sys.platform == "win32":
        return _windows_ports()
    names = await _bluez_names() if sys.platform == "linux" else {}
    bound = [_with_remote(port, names) for port in _device_files()]
    known = {port.remote_address for port in bound}
    unbound = [
        SerialPort(address, name, address)
        for address, name in names.items()
        if address not in known
    ]
    return [*bound, *unbound]


def _device_files() -> list[str]:
    patterns = ("rfcomm*", "ttyUSB*", "ttyACM*", "cu.*")
    return sorted(str(path) for pattern in patterns for path in Path("/dev").glob(pattern))


def _with_remote(port: str, names: dict[str, str]) -> SerialPort:
    try:
        address = Path("/sys/class/tty", Path(port).name, "address").read_text("ascii").strip()
    except OSError:
        return SerialPort(port)
    address = address.upper()
    return SerialPort(port, names.get(address, ""), address)


async def _bluez_names() -> dict[str, str]:
    """Return the names of paired devices with a serial service, by address."""
    known = ((each.advertisement, each.is_paired) for each in await bluez.known_devices())
    return {
        device.address: device.name
        for device, is_paired in known
        if is_paired and device.name and SERIAL_PORT_SERVICE in device.service_uuids
    }


def _windows_ports() -> list[SerialPort]:
    try:
        from serial.tools.list_ports import comports
    except (ImportError, AttributeError):
        return [SerialPort(port) for port in _windows_registry_ports()]
    ports: list[SerialPort] = []
    for port in comports():
        found = _WINDOWS_BLUETOOTH.search(port.hwid)
        if found is None:
            ports.append(SerialPort(port.device))
        elif found[1] != _INCOMING:
            address = found[1].upper()
            ports.append(SerialPort(port.device, _windows_name(address), _with_colons(address)))
    return ports


def _with_colons(address: str) -> str:
    return ":".join(address[index : index + 2] for index in range(0, 12, 2))


def _windows_name(address: str) -> str:
    if sys.platform != "win32":
        return ""
    import winreg

    path = rf"SYSTEM\CurrentControlSet\Services\BTHPORT\Parameters\Devices\{address.lower()}"
    try:
        with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, path) as key:
            raw, _ = winreg.QueryValueEx(key, "Name")
    except OSError:
        return ""
    return bytes(raw).rstrip(b"\0").decode("utf-8", "replace")


def _windows_registry_ports() -> list[str]:
    if sys.platform != "win32":
        return []
    import winreg

    ports: list[str] = []
    try:
        with winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, r"HARDWARE\DEVICEMAP\SERIALCOMM") as key:
            count = winreg.QueryInfoKey(key)[1]
            ports = [str(winreg.EnumValue(key, index)[1]) for index in range(count)]
    except OSError:
        pass
    return sorted(ports)
