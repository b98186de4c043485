"""Drive a respiration belt with godirect, its vendor's client, and print what it read.

    python godirect_reads.py NAME PERIOD_MS...

godirect is under the GPL: this program runs in an environment of its own, as a process
of its own, and nothing of this project imports it or is imported by it. It finds the
device by the name on the air and measures force and respiration rate with each of the
periods in turn. Its output is one JSON object, NaN written as in Python.
"""

from __future__ import annotations

import asyncio
import importlib
import json
import sys
from typing import Any

# By name, since it is in the peers' environment only, where nothing is type-checked.
_godirect: Any = importlib.import_module("godirect")

READS = 40
FORCE, RATE = 1, 2


def measured(device: Any, period_ms: int) -> dict[str, Any]:
    """Measure once; return what the client kept."""
    started = device.start(period=period_ms)
    reads = [device.read() for _ in range(READS)]
    stopped = device.stop()
    force, rate = (list(device.get_sensor(number).values) for number in (FORCE, RATE))
    codes = {"started": started, "stopped": stopped, "reads": reads}
    return codes | {"period_ms": period_ms, "force": force, "rate": rate}


def read(device: Any, periods_ms: list[int]) -> dict[str, Any]:
    """Drive an open device."""
    channels = [
        [each.sensor_number, each.sensor_description, each.sensor_units]
        for each in device.list_sensors().values()
    ]
    device.enable_sensors([FORCE, RATE])
    return {
        "order_code": device.order_code,
        "serial": device.serial_number,
        "address": device.ble_addr,
        "battery_percent": device.battery_level_percent,
        "rssi": device.rssi,
        "channels": channels,
        "runs": [measured(device, period_ms) for period_ms in periods_ms],
    }


def main() -> None:
    # The client takes the thread's loop for its own.
    asyncio.set_event_loop(asyncio.new_event_loop())
    client = _godirect.GoDirect(use_ble=True, use_usb=False)
    name, *periods = sys.argv[1:]
    device = next(each for each in client.list_devices() if each.name == name)
    if not device.open():
        raise ConnectionError(f"{name} cannot be opened")
    try:
        result = read(device, [int(period) for period in periods])
    finally:
        device.close()
    client.quit()
    print(json.dumps(result))


if __name__ == "__main__":
    main()
