"""Checks what the devices of the settings need: Bluetooth, ports, services, licences, no sleep."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import getpass
import os
import re
import socket
import ssl
import sys
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import urlsplit
from uuid import UUID

from biosensor_common import child
from biosensor_common.doctor.check import Finding, error, note, ok, warning
from biosensor_common.errors import (
    ConfigError,
    CredentialError,
    GatewayError,
    SpecError,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.registry import declaration, sensor
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.settings.models import DeviceSettings

if TYPE_CHECKING:
    from biosensor_gateway.devices.driver import DriverEntry
    from biosensor_gateway.settings.secrets import SecretName

_SOCKET = "socket://"
LISTEN_S = 2.0
UNSEEN_ON_WINDOWS = (
    "on Windows, sensors that drop a connection or refuse it are paired, and unpaired at its "
    "end; this has not been tested with a real sensor yet: `pair` in the sensor's table controls "
    "it"
)
_LINUX_FIXES = {
    TransportReason.UNAVAILABLE: "sudo systemctl start bluetooth && rfkill unblock bluetooth && "
    "bluetoothctl power on",
    TransportReason.DENIED: 'sudo usermod -aG bluetooth "$USER", then log out and in',
    TransportReason.BUSY: "bluetoothctl scan off, and close other programs that use Bluetooth",
}
_WINDOWS_FIXES = {
    TransportReason.UNAVAILABLE: "plug the adapter in; Settings > Bluetooth & devices > On",
    TransportReason.DENIED: "Settings > Privacy & security > Radios: let desktop apps use them",
    TransportReason.BUSY: "close other programs that use Bluetooth",
}
_MAC_FIXES = {
    TransportReason.UNAVAILABLE: "System Settings > Bluetooth > On",
    TransportReason.DENIED: "System Settings > Privacy & Security > Bluetooth: allow the terminal",
    TransportReason.BUSY: "close other programs that use Bluetooth",
}
_FIXES = {"win32": _WINDOWS_FIXES, "darwin": _MAC_FIXES}
_ADDRESS = re.compile(r"[0-9A-Fa-f]{2}(?::[0-9A-Fa-f]{2}){5}")
_PAIR = "pair or plug in the device and switch it on, then: biosensor-gateway scan"
CONNECT_S = 3.0
_LOCAL, _ANY_PROGRAM = "127.0.0.1", "the vendor's program"
ANSWER_S = 10.0

ADAPTERS = Path("/sys/class/bluetooth")
_GNOME = "org.gnome.settings-daemon.plugins.power"
_GNOME_KEY = "sleep-inactive-ac-type"
_HELD_OFF = (
    "The agent prevents sleep while a device streams, but not before the first one does, nor "
    "when the lid is closed."
)
_NOT_HELD_OFF = "A recording ends when the computer sleeps, and keep_awake is off in the settings."

# GUID_SLEEP_SUBGROUP and GUID_STANDBY_TIMEOUT of winnt.h.
_SLEEP = UUID("238c9fa8-0aad-41ed-83f4-97be242c8f20")
_STANDBY_TIMEOUT = UUID("29f6c1db-86da-48c5-9fdb-f2b67b1f44da")


class Service(NamedTuple):
    """Address of a vendor's service, or of a serial port behind TCP."""

    title: str
    host: str
    port: int
    program: str  # Program that has to run there.
    # File of the certificate authority, empty for the system's; None for a service without TLS.
    ca_file: str | None = None


def by_bluetooth_le(devices: Iterable[DeviceSettings]) -> list[DeviceSettings]:
    """Return the devices that are connected neither by a port nor by a service."""
    return [each for each in devices if not {"port", "host", "url"} & each.model_dump().keys()]


def serial_ports_of(devices: Iterable[DeviceSettings]) -> dict[str, str]:
    """Return the names of the serial ports, with the sensor of each."""
    found: dict[str, str] = {}
    for each in devices:
        port = each.model_dump().get("port")
        if isinstance(port, str) and not port.startswith(_SOCKET):
            found[port] = each.sensor
    return found


def services_of(devices: Iterable[DeviceSettings]) -> list[Service]:
    """Return the services, each once."""
    return list(dict.fromkeys(found for each in devices for found in _services(each)))


def _services(device: DeviceSettings) -> Iterator[Service]:
    values = device.model_dump()
    title, program = _title_and_program(device.sensor)
    host, port, url = values.get("host"), values.get("port"), values.get("url")
    if isinstance(host, str) and isinstance(port, int):
        yield Service(title, host, port, program)
    elif isinstance(port, str) and port.startswith(_SOCKET):
        yield from _of_url(title, port, program, None)
    elif isinstance(url, str):
        yield from _of_url(title, url, program, str(values.get("ca_file", "")))


def _of_url(title: str, url: str, program: str, ca_file: str | None) -> Iterator[Service]:
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        return
    if host:
        is_tls = parts.scheme == "wss"
        number = port or (443 if is_tls else 80)
        yield Service(title, host, number, program, ca_file if is_tls else None)


def _title_and_program(name: str) -> tuple[str, str]:
    """Return what a sensor is called, and the vendor's program that it needs."""
    try:
        return declaration(name).title, sensor(name).service or _ANY_PROGRAM
    except SpecError:
        return name, _ANY_PROGRAM


def bluetooth(context: Context) -> Iterator[Finding]:
    """Check the adapter by a short scan: it must exist, be on, and be permitted."""
    from biosensor_gateway.transports import ble_errors
    from biosensor_gateway.transports.ble_scanner import scan

    needing = by_bluetooth_le(context.enabled)
    try:
        heard = asyncio.run(scan(LISTEN_S))
    except TransportError as problem:
        yield _unusable(problem, [each.sensor for each in needing])
        return
    amount = "1 device was" if len(heard) == 1 else f"{len(heard)} devices were"
    yield ok(f"Bluetooth is on; {amount} heard in {LISTEN_S:g} s")
    if needing and ble_errors.PLATFORM == "win32":
        yield ok(UNSEEN_ON_WINDOWS)
    if needing and not heard:
        yield note(
            "no Bluetooth device was found",
            "A device that is off, or connected elsewhere, such as to a phone, cannot be found.",
            "switch the sensor on, wear it, disconnect it from phones, then: biosensor-gateway "
            "scan",
        )


def _unusable(problem: TransportError, needing: list[str]) -> Finding:
    fix = _FIXES.get(sys.platform, _LINUX_FIXES).get(problem.reason, "biosensor-gateway scan")
    if needing:
        why = f"{', '.join(dict.fromkeys(needing))} cannot be reached without it."
        return error(str(problem), why, fix)
    why = "No device in the settings needs it; the others are not affected."
    return note(str(problem), why, fix)


def serial(context: Context) -> Iterator[Finding]:
    """Check whether each port exists and may be opened."""
    # No port is opened, because opening a Bluetooth port makes the radio connect.
    named = serial_ports_of(context.enabled)
    if not named:
        yield ok("no device in the settings has a serial port")
        return
    from biosensor_gateway.transports.serial_port import serial_ports  # needs D-Bus

    present = asyncio.run(serial_ports())
    known = {each.port.upper() for each in present} | {
        each.remote_address.upper() for each in present
    }
    for port, name in named.items():
        if _ADDRESS.fullmatch(port):
            yield _paired(port, name, known)
        elif sys.platform == "win32":
            yield _windows_port(port, name, known)
        else:
            yield device_file(Path(port), name)


def _paired(address: str, sensor: str, known: Collection[str]) -> Finding:
    if address.upper() in known:
        return ok(f"{sensor}: {address} is paired")
    return warning(
        f"{sensor}: {address} is not known as a paired device with a serial service",
        "Bluetooth Classic devices connect only to computers that they are paired with.",
        f"bluetoothctl pair {address}"
        if sys.platform == "linux"
        else "pair it in the system's Bluetooth settings",
    )


def _windows_port(port: str, sensor: str, known: Collection[str]) -> Finding:
    if port.upper() in known:
        return ok(f"{sensor}: {port} is there")
    return _absent(port, sensor)


def device_file(path: Path, sensor: str) -> Finding:
    """Check a port that is a device file."""
    if not path.exists():
        return _absent(str(path), sensor)
    if os.access(path, os.R_OK | os.W_OK):
        return ok(f"{sensor}: {path} exists and can be opened")
    group = _group(path)
    return error(
        f"{sensor}: you do not have permission to open {path}",
        f"It belongs to the group {group}; {getpass.getuser()} is not in that group, or was not "
        "when this session started.",
        f'sudo usermod -aG {group} "$USER", then log out and in',
    )


def _absent(port: str, sensor: str) -> Finding:
    return error(
        f"{sensor}: there is no port {port}",
        "The agent keeps looking for it, and streams nothing from this device until it appears.",
        f"{_PAIR}\nand correct port, if its name has changed: biosensor-gateway config edit",
    )


def _group(path: Path) -> str:
    if sys.platform != "win32":
        # A group may have no name, and the port may have been removed.
        with contextlib.suppress(KeyError, OSError):
            return path.group()
    return "dialout"


def services(context: Context) -> Iterator[Finding]:
    """Check each service by connecting to it, the secrets, and LabRecorder."""
    for service in services_of(context.enabled):
        yield _service(service)
    yield from _secrets(context)
    yield lab_recorder(context.lab_recorder_port)


def _service(service: Service) -> Finding:
    where = f"{service.title}: {service.host}:{service.port}"
    try:
        with socket.create_connection((service.host, service.port), CONNECT_S) as connection:
            if service.ca_file is not None:
                from biosensor_gateway.transports.websocket import tls_context

                context = tls_context(service.ca_file)
                context.wrap_socket(connection, server_hostname=service.host).close()
    except ssl.SSLError as problem:
        return error(
            f"{where} answers, but its certificate is not trusted ({problem.reason or problem})",
            "The agent does not send secrets to a service that it cannot verify.",
            f"install {service.program} on this computer, or set ca_file to the vendor's root "
            "certificate: biosensor-gateway config edit",
        )
    except ConfigError as problem:
        return error(
            str(problem),
            "The service cannot be trusted without it.",
            "correct ca_file: biosensor-gateway config edit",
        )
    except OSError as problem:
        return error(
            f"{where} does not answer ({problem.strerror or problem})",
            "The agent keeps trying, and streams nothing from this device until it does.",
            f"start {service.program} on that computer and log in there; if it runs elsewhere: "
            "biosensor-gateway config edit",
        )
    return ok(f"{where} answers{'' if service.ca_file is None else ' with a trusted certificate'}")


def _secrets(context: Context) -> Iterator[Finding]:
    sensors = dict.fromkeys(device.sensor for device in context.enabled)
    if not sensors:
        return
    from biosensor_gateway.devices.registry import driver  # brings all drivers' libraries
    from biosensor_gateway.settings.secrets import find_secret

    for name in sensors:
        for secret in driver(name).secrets:
            try:
                find_secret(secret)
            except CredentialError as problem:
                yield error(
                    str(problem),
                    "The vendor's service refuses unknown programs.",
                    f"biosensor-gateway secrets set {name}",
                )
            else:
                yield ok(f"{name}: {secret.title} is there")


def lab_recorder(port: int) -> Finding:
    """Check whether LabRecorder can be controlled from here."""
    try:
        socket.create_connection((_LOCAL, port), CONNECT_S).close()
    except OSError:
        return note(
            f"LabRecorder's remote control does not answer on TCP {port}",
            "LabRecorder is not running here, or its remote control is off. Only scripts that "
            "start and stop recordings need it.",
            "start LabRecorder and tick 'Enable RCS'",
        )
    return ok(f"something answers on TCP {port}, the port of LabRecorder's remote control")


def licences(context: Context) -> Iterator[Finding]:
    """Check by signing in to each licensed service which streams the licence does not cover."""
    if not context.enabled:
        return
    from biosensor_gateway.devices.registry import driver  # brings all drivers' libraries

    asked: set[str] = set()
    for device in context.enabled:
        entry = driver(device.sensor)
        # One licence serves all devices of a service.
        if entry.unlicensed is None or device.sensor in asked or not _are_there(entry.secrets):
            continue
        asked.add(device.sensor)
        yield from _licence(entry, device)


def _licence(entry: DriverEntry, device: DeviceSettings) -> Iterator[Finding]:
    title = declaration(device.sensor).title
    try:
        clauses = asyncio.run(_unlicensed(entry, device))
    except CredentialError as problem:
        yield error(
            f"{title}: {problem}",
            "The agent keeps trying, and streams nothing from this device until it is allowed.",
            "follow that sentence in the vendor's program",
        )
    except (GatewayError, TimeoutError) as problem:
        yield note(
            f"{title}: its licence could not be checked ({problem or 'no answer'})",
            "Streams that it does not cover stay empty.",
            "run the services check first: biosensor-gateway doctor --only services",
        )
    else:
        for clause in clauses:
            yield warning(
                f"{title}: the licence: {clause}",
                "A recording then has such a stream, with too little or nothing in it.",
                "extend the licence in your account with the vendor, or do without it; "
                "wait-ready then needs its option --without",
            )
        if not clauses:
            yield ok(f"{title}: the licence covers all streams")


async def _unlicensed(entry: DriverEntry, device: DeviceSettings) -> Sequence[str]:
    if entry.unlicensed is None:
        return ()
    async with asyncio.timeout(ANSWER_S):
        return await entry.unlicensed(device)


def _are_there(secrets: Sequence[SecretName]) -> bool:
    """Whether all secrets are found; the check of the services reports missing ones."""
    from biosensor_gateway.settings.secrets import find_secret  # slow to import

    try:
        for secret in secrets:
            find_secret(secret)
    except CredentialError:
        return False
    return True


def _sleep_timeout_s() -> int | None:
    """Return the idle time in s after which Windows sleeps on mains; 0 for never, None unknown."""
    if sys.platform != "win32":
        return None
    scheme = ctypes.c_void_p()
    seconds = ctypes.c_uint32()
    try:
        library = ctypes.WinDLL("powrprof")
        if library.PowerGetActiveScheme(None, ctypes.byref(scheme)):
            return None
        failed = library.PowerReadACValueIndex(
            None, scheme, _guid(_SLEEP), _guid(_STANDBY_TIMEOUT), ctypes.byref(seconds)
        )
        ctypes.WinDLL("kernel32").LocalFree(scheme)
    except (OSError, AttributeError):
        # Reduced editions of Windows have no power schemes.
        return None
    return None if failed else seconds.value


def _guid(value: UUID) -> ctypes.Array[ctypes.c_char]:
    return ctypes.create_string_buffer(value.bytes_le, len(value.bytes_le))


def power(context: Context) -> Iterator[Finding]:
    """Check sleep, mains and Bluetooth."""
    yield from _sleep(context.keep_awake)
    yield from _battery()
    if sys.platform == "linux":
        yield from adapters(ADAPTERS)
    elif sys.platform == "win32" and by_bluetooth_le(context.enabled):
        yield note(
            "Windows may switch the Bluetooth adapter off to save power",
            "The sensors then drop out, and come back only by chance.",
            "Device Manager > Bluetooth > the adapter > Properties > Power Management: clear "
            "'Allow the computer to turn off this device'",
        )


def _sleep(keep_awake: bool) -> Iterator[Finding]:
    if sys.platform == "linux":
        after = _linux_sleep()
        fix = f"gsettings set {_GNOME} {_GNOME_KEY} nothing"
    elif sys.platform == "win32":
        after = _windows_sleep()
        fix = "powercfg /change standby-timeout-ac 0"
    else:
        return
    if after is None:
        yield ok("no setting is known that sends this computer to sleep automatically")
    elif keep_awake:
        yield note(f"this computer goes to sleep {after}", _HELD_OFF, fix)
    else:
        yield warning(f"this computer goes to sleep {after}", _NOT_HELD_OFF, fix)


def _linux_sleep() -> str | None:
    masked = child.output_of("systemctl", "is-enabled", "sleep.target")
    if masked is not None and masked.strip() == "masked":
        return None
    desktop = child.output_of("gsettings", "get", _GNOME, _GNOME_KEY)
    if desktop is not None and "suspend" in desktop:
        return "when it is idle (the desktop's setting for mains power)"
    return None


def _windows_sleep() -> str | None:
    seconds = _sleep_timeout_s()
    return f"after {seconds / 60:g} minutes on mains power" if seconds else None


def _battery() -> Iterator[Finding]:
    import psutil

    state = None
    # psutil lacks the function on some systems, and containers have no folder of batteries.
    with contextlib.suppress(AttributeError, OSError):
        state = psutil.sensors_battery()
    if state is not None and state.power_plugged is False:
        yield note(
            f"this computer runs on battery ({state.percent:.0f} percent)",
            "It saves power at the expense of radio and timing, and may go to sleep regardless "
            "of what the agent asks for.",
            "plug it in",
        )


def adapters(folder: Path) -> Iterator[Finding]:
    """Check the power saving of USB Bluetooth adapters on Linux; *folder* is as `ADAPTERS`."""
    for adapter in sorted(folder.glob("hci*")):
        # The adapter is an interface of the USB device.
        for control in (adapter / "device/../power/control", adapter / "device/power/control"):
            if _is_auto(control):
                yield note(
                    f"the Bluetooth adapter {adapter.name} may be suspended (USB autosuspend)",
                    "Some adapters then lose connections or do not come back.",
                    f"echo on | sudo tee {control.resolve()}\npermanently: options btusb "
                    "enable_autosuspend=0 in /etc/modprobe.d/btusb.conf",
                )
                break


def _is_auto(control: Path) -> bool:
    try:
        return control.read_text("ascii").strip() == "auto"
    except (OSError, ValueError):
        return False
