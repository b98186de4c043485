"""Builds the advertisements of virtual Bluetooth LE devices, as bytes and decoded.

Layout: Supplement to the Bluetooth Core Specification, Part A.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bleak.uuids import normalize_uuid_str
from bumble.core import UUID, AdvertisingData

_MAX_BYTES = 31
_LE_ONLY_GENERAL_DISCOVERABLE = 0x06
_Kind = AdvertisingData.Type


def pack_advertisement(uuids: Sequence[UUID], manufacturer_data: Mapping[int, bytes]) -> bytes:
    """Return flags, service UUIDs and manufacturer data.

    Raises
    ------
    ValueError
        If they are longer than a legacy advertisement, 31 bytes.
    """
    structures: list[tuple[int, bytes]] = [(_Kind.FLAGS, bytes([_LE_ONLY_GENERAL_DISCOVERABLE]))]
    for kind, size in (
        (_Kind.COMPLETE_LIST_OF_16_BIT_SERVICE_CLASS_UUIDS, 2),
        (_Kind.COMPLETE_LIST_OF_128_BIT_SERVICE_CLASS_UUIDS, 16),
    ):
        if listed := b"".join(bytes(uuid) for uuid in uuids if len(bytes(uuid)) == size):
            structures.append((kind, listed))
    for company, data in manufacturer_data.items():
        structures.append((_Kind.MANUFACTURER_SPECIFIC_DATA, company.to_bytes(2, "little") + data))
    return _packed(structures)


def pack_name(name: str) -> bytes:
    """Return the complete local name, for a scan response.

    Raises
    ------
    ValueError
        If it is longer than 29 bytes.
    """
    return _packed([(_Kind.COMPLETE_LOCAL_NAME, name.encode())])


@dataclass
class Advertised:
    """The combined contents of a device's advertisement and scan response."""

    rssi_dbm: int = -127
    name: str | None = None
    service_uuids: list[str] = field(default_factory=list[str])
    manufacturer_data: dict[int, bytes] = field(default_factory=dict[int, bytes])

    def hear(self, data: bytes, rssi_dbm: int) -> None:
        """Add an advertisement or a scan response."""
        self.rssi_dbm = rssi_dbm
        for kind, content in AdvertisingData.from_bytes(data).ad_structures:
            if kind == _Kind.COMPLETE_LOCAL_NAME:
                self.name = content.decode()
            elif kind == _Kind.MANUFACTURER_SPECIFIC_DATA:
                self.manufacturer_data[int.from_bytes(content[:2], "little")] = content[2:]
            elif kind == _Kind.COMPLETE_LIST_OF_16_BIT_SERVICE_CLASS_UUIDS:
                self._list(content, 2)
            elif kind == _Kind.COMPLETE_LIST_OF_128_BIT_SERVICE_CLASS_UUIDS:
                self._list(content, 16)

    def _list(self, content: bytes, size: int) -> None:
        for start in range(0, len(content), size):
            uuid = uuid_string(UUID.from_bytes(content[start : start + size]))
            if uuid not in self.service_uuids:
                self.service_uuids.append(uuid)


def uuid_string(uuid: UUID) -> str:
    """Return a UUID in the form of bleak and BlueZ: 128 bits, in lower case."""
    return normalize_uuid_str(uuid.to_hex_str("-"))


def _packed(structures: Sequence[tuple[int, bytes]]) -> bytes:
    packed = b"".join(bytes([len(data) + 1, kind]) + data for kind, data in structures)
    if len(packed) > _MAX_BYTES:
        raise ValueError(f"{len(packed)} bytes do not fit into an advertisement")
    return packed
