"""Read a Polar Verity Sense with polar-python, another project's client, and print what it read.

    python polar_python_reads_light.py NAME

It finds the device by the name on the air. Its output is one JSON object; values are as the
client has them: light in counts, acceleration in mg or as it scales it, angular velocity in
deg/s, field in gauss, intervals in ms, and stamps of frames in ns since 1970.
"""

from __future__ import annotations

import asyncio
import importlib
import json
import sys
from typing import Any

from bleak import BleakScanner

# By name, since it is in the peers' environment only, where nothing is type-checked.
_polar: Any = importlib.import_module("polar_python")
_constants: Any = importlib.import_module("polar_python.constants")

FRAMES, BATCHES = 3, 1
THREE_AXES = {"sample_rate": 52, "resolution": 16, "channels": 3}
PATIENCE_S = 60.0


class Listener:
    """Collects what the client hands out."""

    def __init__(self) -> None:
        self.frames: dict[str, list[Any]] = {name: [] for name in ("ppg", "acc", "gyro", "mag")}
        self.batches: list[Any] = []
        self.enough = asyncio.Event()

    def keep(self, name: str) -> Any:
        def take(frame: Any) -> None:
            self.frames[name].append(frame)
            self._count()

        return take

    def batch(self, batch: Any) -> None:
        self.batches.append(batch)
        self._count()

    def _count(self) -> None:
        shortest = min(len(frames) for frames in self.frames.values())
        if shortest >= FRAMES and len(self.batches) >= BATCHES:
            self.enough.set()


def samples_of(frame: Any) -> list[list[float]]:
    """Return what the client's record of a frame holds, whatever it calls it."""
    samples = frame.samples if hasattr(frame, "samples") else frame.data
    return [[each.x, each.y, each.z] if hasattr(each, "x") else list(each) for each in samples]


async def settings(device: Any, kind: Any) -> dict[str, list[int]]:
    """Return what the device offers for one measurement."""
    offered = await device.request_stream_settings(kind)
    if offered.error_code != _constants.PmdControlPointErrorCode.SUCCESS:
        raise ValueError(f"{kind.name}: {offered.error_code}")
    return {setting.type.name: setting.values for setting in offered.settings}


async def stream(device: Any, listener: Listener) -> None:
    """Let everything stream until there is enough."""
    await device.start_ppi_stream(listener.batch)
    await device.start_ppg_stream(listener.keep("ppg"), sample_rate=55, resolution=22, channels=4)
    await device.start_acc_stream(listener.keep("acc"), range=8, **THREE_AXES)
    await device.start_gyro_stream(listener.keep("gyro"), range=2000, **THREE_AXES)
    await device.start_mag_stream(
        listener.keep("mag"), sample_rate=100, resolution=16, range=50, channels=3
    )
    await asyncio.wait_for(listener.enough.wait(), PATIENCE_S)


async def read(name: str) -> dict[str, Any]:
    found = await BleakScanner.find_device_by_name(name, timeout=PATIENCE_S)
    if found is None:
        raise TimeoutError(f"{name} is not heard")
    listener = Listener()
    async with _polar.PolarDevice(found) as device:
        kinds = await device.get_available_features()
        offered = {kind.name: await settings(device, kind) for kind in kinds if kind.name != "PPI"}
        await stream(device, listener)
    return {
        "measurements": [kind.name for kind in kinds],
        "settings": offered,
        "ppi": [
            [each.ppi, each.error_estimate] for batch in listener.batches for each in batch.samples
        ],
        **{
            name: {
                "stamps_ns": [frame.timestamp for frame in frames],
                "sizes": [len(samples_of(frame)) for frame in frames],
                "samples": [sample for frame in frames for sample in samples_of(frame)],
            }
            for name, frames in listener.frames.items()
        },
    }


def main() -> None:
    print(json.dumps(asyncio.run(read(sys.argv[1]))))


if __name__ == "__main__":
    main()
