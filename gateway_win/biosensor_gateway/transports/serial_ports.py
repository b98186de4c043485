"""Lists serial ports, with the names of the Bluetooth devices behind them.

No port is opened: opening a Bluetooth port makes the radio connect. Descriptions of
ports are in the system's language, so nothing is decided by them.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from biosensor_gateway.transports import bluez
from biosensor_gateway.transports.nearby import SerialPort

SERIAL_PORT_SERVICE = "00001101-0000-1000-8000-00805f9b34fb"
# BTHENUM\{00001101-0000-...}_LOCALMFG&0000\7&23456789&0&000666AABBCC_C00000000, and for a port
# that waits for a caller ...&0&000000000000_00000000
_WINDOWS_BLUETOOTH = re.compile(r"BTHENUM\\\{00001101-.*&([0-9A-F]{12})_", re.IGNORECASE)
_INCOMING = "000000000000"


async def serial_ports() -> list[SerialPort]:
    """List the ports that a driver could open; never raises.

    On Linux paired Bluetooth devices with a serial service are listed by their
    address, which a driver can open as well.
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
    """Names by address of the paired devices that have a serial service."""
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
