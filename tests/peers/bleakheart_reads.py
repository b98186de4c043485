"""Read a Polar H10 with bleakheart, another project's client, and print what it read.

    python bleakheart_reads.py NAME

It finds the device by the name on the air. Its output is one JSON object; counts are as
the client has them: heart rate in 1/min, intervals in ms, ECG in uV, acceleration in mg,
and stamps of frames in ns of the device's clock, moved to the host's epoch.
"""

from __future__ import annotations

import asyncio
import importlib
import json
import sys
from typing import Any

from bleak import BleakClient, BleakScanner

# By name, since it is in the peers' environment only, where nothing is type-checked.
_bleakheart: Any = importlib.import_module("bleakheart")

PULSES, FRAMES = 5, 8
ACC_SETTINGS = {"SAMPLE_RATE": 200, "RANGE": 8}
PATIENCE_S = 30.0


class Listener:
    """Collects what the client hands out."""

    def __init__(self) -> None:
        self.pulses: list[Any] = []
        self.frames: dict[str, list[Any]] = {"ECG": [], "ACC": []}
        self.enough = asyncio.Event()

    def pulse(self, pulse: Any) -> None:
        self.pulses.append(pulse)
        shortest = min(len(frames) for frames in self.frames.values())
        if len(self.pulses) >= PULSES and shortest >= FRAMES:
            self.enough.set()

    def frame(self, frame: Any) -> None:
        self.frames[frame[0]].append(frame)

    def result(self) -> dict[str, Any]:
        return {
            "hr": [rate for _, _, (rate, _), _ in self.pulses],
            "rr_ms": [rr for _, _, (_, intervals), _ in self.pulses for rr in intervals],
        } | {
            name.lower(): {
                "stamps_ns": [stamp for _, stamp, _ in frames],
                "sizes": [len(samples) for _, _, samples in frames],
                "samples": [sample for _, _, samples in frames for sample in samples],
            }
            for name, frames in self.frames.items()
        }


async def stream(client: BleakClient, pmd: Any, listener: Listener) -> dict[str, Any]:
    """Let everything stream until there is enough; return the codes of the replies."""
    pulse = _bleakheart.HeartRate(client, callback=listener.pulse, unpack=False)
    await pulse.start_notify()
    started = [
        (await pmd.start_streaming("ECG"))[0],
        (await pmd.start_streaming("ACC", **ACC_SETTINGS))[0],
    ]
    await asyncio.wait_for(listener.enough.wait(), PATIENCE_S)
    stopped = [(await pmd.stop_streaming(name))[0] for name in listener.frames]
    await pulse.stop_notify()
    return {"started": started, "stopped": stopped}


async def read(name: str) -> dict[str, Any]:
    device = await BleakScanner.find_device_by_name(name, timeout=PATIENCE_S)
    if device is None:
        raise TimeoutError(f"{name} is not heard")
    listener = Listener()
    async with BleakClient(device) as client:
        pmd = _bleakheart.PolarMeasurementData(client, callback=listener.frame)
        result = {
            "battery_percent": await _bleakheart.BatteryLevel(client).read(),
            "measurements": await pmd.available_measurements(),
            "settings": {kind: await pmd.available_settings(kind) for kind in listener.frames},
        }
        return result | await stream(client, pmd, listener) | listener.result()


def main() -> None:
    print(json.dumps(asyncio.run(read(sys.argv[1]))))


if __name__ == "__main__":
    main()
