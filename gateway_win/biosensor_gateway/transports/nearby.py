"""Records of reachable devices: advertisements and serial ports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Advertisement:
    """The advertisement of a Bluetooth LE device."""

    address: str  # MAC address; on macOS an identifier that is only valid on this computer.
    name: str = ""  # Empty until it has been received.
    rssi_dbm: int | None = None
    service_uuids: frozenset[str] = frozenset()  # 128-bit, lower case.
    # Payload by company identifier.
    manufacturer_data: Mapping[int, bytes] = field(default_factory=dict[int, bytes])


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A serial port of this computer."""

    port: str  # The name to open.
    remote_name: str = ""  # Name of its Bluetooth device; empty if there is none or it is unknown.
    remote_address: str = ""  # Its MAC address as `AA:BB:CC:DD:EE:FF`, empty if unknown.
