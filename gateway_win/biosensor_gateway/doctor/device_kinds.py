"""Tells from the keys of a device's table by which link it is reached."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple
from urllib.parse import urlsplit

from biosensor_common.errors import SpecError
from biosensor_gateway.devices.registry import declaration, sensor
from biosensor_gateway.settings.models import DeviceSettings

_SOCKET = "socket://"


class Service(NamedTuple):
    """Where a vendor's service, or a port behind TCP, is expected.

    Attributes
    ----------
    title
        What a person calls it.
    program
        What has to run there.
    ca_file
        Certificate authority of a service that speaks TLS, empty for the system's; None for
        one that does not.
    """

    title: str
    host: str
    port: int
    program: str
    ca_file: str | None = None


def by_bluetooth_le(devices: Iterable[DeviceSettings]) -> list[DeviceSettings]:
    """Return the devices that are reached neither by a port nor by a service."""
    return [each for each in devices if not {"port", "host", "url"} & _values(each).keys()]


def serial_ports(devices: Iterable[DeviceSettings]) -> dict[str, str]:
    """Return the names of the serial ports, with the sensor of each."""
    found: dict[str, str] = {}
    for each in devices:
        port = _values(each).get("port")
        if isinstance(port, str) and not port.startswith(_SOCKET):
            found[port] = each.sensor
    return found


def services(devices: Iterable[DeviceSettings]) -> list[Service]:
    """Return the services, each once."""
    return list(dict.fromkeys(found for each in devices for found in _services(each)))


def _services(device: DeviceSettings) -> Iterator[Service]:
    values, title = _values(device), _title(device.sensor)
    host, port, url = values.get("host"), values.get("port"), values.get("url")
    if isinstance(host, str) and isinstance(port, int):
        yield Service(title, host, port, _program(device.sensor))
    elif isinstance(port, str) and port.startswith(_SOCKET):
        yield from _of_url(title, port, _program(device.sensor), None)
    elif isinstance(url, str):
        yield from _of_url(title, url, _program(device.sensor), str(values.get("ca_file", "")))


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


def _title(name: str) -> str:
    try:
        return declaration(name).title
    except SpecError:
        return name


def _program(name: str) -> str:
    try:
        return sensor(name).service or "the vendor's program"
    except SpecError:
        return "the vendor's program"


def _values(device: DeviceSettings) -> dict[str, object]:
    return device.model_dump()
