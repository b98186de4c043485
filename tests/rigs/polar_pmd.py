"""The measurement data of a Polar sensor, as plain bleak and a small decoder of its own see it."""

from __future__ import annotations

from typing import NamedTuple

from tests.rigs.gatt_host import GattHost

HEART_RATE = "2a37"
CONTROL = "fb005c81-02e7-f387-1cad-8acd2d8df0c8"
DATA = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"
NAME = "Polar H10 A1B2C3D4"
START_ECG = "020000018200 01010e00"
START_ACC = "02020201080000 01c80001011000"


class Frame(NamedTuple):
    """One frame: the kind of measurement, the time of its last sample, layout and samples."""

    kind: int
    stamp_ns: int
    layout: int
    body: bytes


def frames_of(host: GattHost, kind: int) -> list[Frame]:
    """Return the frames of one measurement that have come so far."""
    found = [
        Frame(data[0], int.from_bytes(data[1:9], "little"), data[9], data[10:])
        for data in host.all(DATA)
    ]
    return [frame for frame in found if frame.kind == kind]


def int24(body: bytes) -> list[int]:
    """Read signed numbers of three bytes each."""
    return [
        int.from_bytes(body[at : at + 3], "little", signed=True) for at in range(0, len(body), 3)
    ]


async def open_pmd(host: GattHost) -> None:
    """Subscribe to what carries commands and measurements."""
    await host.subscribe(CONTROL, DATA)
