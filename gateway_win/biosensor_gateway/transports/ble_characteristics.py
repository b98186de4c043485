"""Keeps which characteristics a Bluetooth LE device has."""

from __future__ import annotations

from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.service import BleakGATTServiceCollection
from bleak.uuids import normalize_uuid_str


class Characteristics:
    """Those of one device, also after the link is gone; UUIDs have 16 or 128 bits."""

    def __init__(self) -> None:
        self._by_uuid: dict[str, BleakGATTCharacteristic] = {}

    def learn(self, services: BleakGATTServiceCollection) -> None:
        """Take in what the device has now; of two with one UUID, the first counts."""
        self._by_uuid.clear()
        for service in services:
            for each in service.characteristics:
                self._by_uuid.setdefault(each.uuid.lower(), each)

    def find(self, uuid: str) -> BleakGATTCharacteristic | None:
        """Return a characteristic; None if the device has none such."""
        return self._by_uuid.get(normalize_uuid_str(uuid))
