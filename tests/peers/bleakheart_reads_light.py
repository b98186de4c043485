"""Read a Polar Verity Sense with bleakheart, another project's client, and print what it read.

    python bleakheart_reads_light.py NAME

It finds the device by the name on the air. Its output is one JSON object; counts are as the
client has them: heart rate in 1/min, light in counts, and stamps of frames in ns of the device's
clock, moved to the host's epoch. Of measurements that it does not decode it passes on frames.
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

KINDS = ("PPG", "ACC", "GYRO", "MAG")
PPG_SETTINGS = {"SAMPLE_RATE": 176, "RESOLUTION": 22, "CHANNELS": 4}
FRAMES, PULSES = 6, 2
PATIENCE_S = 40.0


class Listener:
    """Collects what the client hands out."""

    def __init__(self) -> None:
        self.rates: list[int] = []
        self.light: list[Any] = []
        self.enough = asyncio.Event()

    def pulse(self, pulse: Any) -> None:
        self.rates.append(pulse[2][0])
        if len(self.rates) >= PULSES:
            self.enough.set()

    def frame(self, frame: Any) -> None:
        self.light.append(frame)
        if len(self.light) >= FRAMES:
            self.enough.set()


async def in_sdk_mode(pmd: Any, listener: Listener) -> dict[str, Any]:
    """Let light come at a rate that only the SDK mode has."""
    codes = [(await pmd.start_streaming("SDK"))[0]]
    settings = await pmd.available_settings("PPG")
    listener.enough.clear()
    codes.append((await pmd.start_streaming("PPG", **PPG_SETTINGS))[0])
    await asyncio.wait_for(listener.enough.wait(), PATIENCE_S)
    codes.append((await pmd.stop_streaming("PPG"))[0])
    codes.append((await pmd.stop_streaming("SDK"))[0])
    return {"codes": codes, "sdk_settings": settings}


async def read(name: str) -> dict[str, Any]:
    device = await BleakScanner.find_device_by_name(name, timeout=PATIENCE_S)
    if device is None:
        raise TimeoutError(f"{name} is not heard")
    listener = Listener()
    async with BleakClient(device) as client:
        pulse = _bleakheart.HeartRate(client, callback=listener.pulse, unpack=False)
        await pulse.start_notify()
        await asyncio.wait_for(listener.enough.wait(), PATIENCE_S)
        await pulse.stop_notify()
        pmd = _bleakheart.PolarMeasurementData(client, callback=listener.frame)
        measurements = await pmd.available_measurements()
        settings = {kind: await pmd.available_settings(kind) for kind in KINDS}
        light = await in_sdk_mode(pmd, listener)
    return light | {
        "hr": listener.rates,
        "measurements": measurements,
        "settings": settings,
        "stamps_ns": [stamp for _, stamp, _ in listener.light],
        "sizes": [len(samples) for _, _, samples in listener.light],
        "references": [samples[0] for _, _, samples in listener.light],
    }


def main() -> None:
    print(json.dumps(asyncio.run(read(sys.argv[1]))))


if __name__ == "__main__":
    main()
