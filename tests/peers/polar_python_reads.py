"""Read a Polar H10 with polar-python, another project's client, and print what it read.

    python polar_python_reads.py NAME

It finds the device by the name on the air. Its output is one JSON object; counts are as
the client has them: heart rate in 1/min, intervals in ms, ECG in uV, acceleration in mg,
and stamps of frames in ns since 1970 on the device's clock.
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

PULSES, FRAMES = 5, 8
ECG_SETTINGS = {"sample_rate": 130, "resolution": 14}
ACC_SETTINGS = {"sample_rate": 100, "resolution": 16, "range": 4}
PATIENCE_S = 30.0


class Listener:
    """Collects what the client hands out."""

    def __init__(self) -> None:
        self.pulses: list[Any] = []
        self.frames: dict[str, list[Any]] = {"ecg": [], "acc": []}
        self.enough = asyncio.Event()

    def pulse(self, pulse: Any) -> None:
        self.pulses.append(pulse)
        shortest = min(len(frames) for frames in self.frames.values())
        if len(self.pulses) >= PULSES and shortest >= FRAMES:
            self.enough.set()

    def result(self) -> dict[str, Any]:
        return {
            "hr": [pulse.heartrate for pulse in self.pulses],
            "rr_ms": [rr for pulse in self.pulses for rr in pulse.rr_intervals],
        } | {
            name: {
                "stamps_ns": [frame.timestamp for frame in frames],
                "sizes": [len(frame.data) for frame in frames],
                "samples": [sample for frame in frames for sample in frame.data],
            }
            for name, frames in self.frames.items()
        }


async def settings(device: Any, kind: Any) -> dict[str, list[int]]:
    """Return what the device offers for one measurement."""
    offered = await device.request_stream_settings(kind)
    if offered.error_code != _constants.PmdControlPointErrorCode.SUCCESS:
        raise ValueError(f"{kind.name}: {offered.error_code}")
    return {setting.type.name: setting.values for setting in offered.settings}


async def stream(device: Any, listener: Listener) -> None:
    """Let everything stream until there is enough."""
    await device.start_hr_stream(listener.pulse)
    await device.start_ecg_stream(listener.frames["ecg"].append, **ECG_SETTINGS)
    await device.start_acc_stream(listener.frames["acc"].append, **ACC_SETTINGS)
    await asyncio.wait_for(listener.enough.wait(), PATIENCE_S)
    await device.stop_acc_stream()
    await device.stop_ecg_stream()
    await device.stop_hr_stream()


async def read(name: str) -> dict[str, Any]:
    found = await BleakScanner.find_device_by_name(name, timeout=PATIENCE_S)
    if found is None:
        raise TimeoutError(f"{name} is not heard")
    listener = Listener()
    async with _polar.PolarDevice(found) as device:
        kinds = await device.get_available_features()
        result = {
            "measurements": [kind.name for kind in kinds],
            "settings": {kind.name: await settings(device, kind) for kind in kinds},
        }
        await stream(device, listener)
    return result | listener.result()


def main() -> None:
    print(json.dumps(asyncio.run(read(sys.argv[1]))))


if __name__ == "__main__":
    main()
