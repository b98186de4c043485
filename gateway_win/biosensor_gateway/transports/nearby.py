"""Records of reachable devices: advertisements and serial ports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Advertisement:
    """The advertisement of a Bluetooth LE device.

    Attributes
    ----------
    address
        MAC address; on macOS an identifier that is only valid on this computer.
    name
        Empty until it has been received.
    service_uuids
        128-bit, lower case.
    manufacturer_data
        Payload by company identifier.
    """

    address: str
    name: str = ""
    rssi_dbm: int | None = None
    service_uuids: frozenset[str] = frozenset()
    manufacturer_data: Mapping[int, bytes] = field(default_factory=dict[int, bytes])


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A serial port of this computer.

    Attributes
    ----------
    port
        The name to open.
    remote_name
        Name of its Bluetooth device; empty if there is none or it is unknown.
    remote_address
        Its MAC address as ``AA:BB:CC:DD:EE:FF``, empty if unknown.
    """

    port: str
    remote_name: str = ""
    remote_address: str = ""
