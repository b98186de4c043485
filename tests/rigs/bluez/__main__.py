"""Virtual devices on a fake BlueZ, in a process of their own.

``python -m tests.rigs.bluez polar_h10 ble_heart_rate`` starts them (``probe`` is the
made-up device of the tests), prints one line of JSON with the ``environment`` that other
processes need and the ``settings`` that lead to each device, and then reads commands, one
a line, until its input ends. It answers each with a line, ``ok`` or what is wrong::

    fault polar_h10:drop:5s     as the command line of the agent has it, without the start
    powered off                 or on
    forget A0:9E:1A:00:00:01
    connect_error TEXT          or nothing
    connect_delay SECONDS
    forgets_after_scan on       or off
    die
    rise
    kill_bus
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from biosensor_common.errors import ConfigError
from biosensor_gateway.demo.virtual_devices import make
from biosensor_gateway.simulation.faults import parse_fault
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from tests.rigs.bluez.adapter import BluezScene, FakeBluez
from tests.rigs.probe import Probe

_PROBE = "probe"
_PROBE_ADDRESS = "A0:9E:1A:00:00:01"


def main() -> None:
    """Run until standard input ends."""
    with ExitStack() as stack:
        scene = BluezScene(stack)
        devices = {
            name: stack.enter_context(make(name, scene)) for name in sys.argv[1:] if name != _PROBE
        }
        settings = {name: dict(device.settings) for name, device in devices.items()}
        if _PROBE in sys.argv[1:]:
            Probe(scene.radio, _PROBE_ADDRESS, "Probe 1").power_on()
            settings[_PROBE] = {"device": _PROBE_ADDRESS}
        bluez = scene.bluez
        assert bluez is not None, "none of these is on the air"
        _say(json.dumps({"environment": bluez.environment, "settings": settings}))
        for line in sys.stdin:
            _say(_obey(line.strip(), bluez, devices))


def _obey(line: str, bluez: FakeBluez, devices: dict[str, VirtualDevice]) -> str:
    command, _, argument = line.partition(" ")
    commands: dict[str, Callable[[], Any]] = {
        "fault": lambda: _fault(argument, devices),
        "powered": lambda: bluez.set_powered(argument == "on"),
        "forget": lambda: bluez.forget(argument),
        "connect_error": lambda: setattr(bluez, "connect_error", argument),
        "connect_delay": lambda: setattr(bluez, "connect_delay_s", float(argument)),
        "forgets_after_scan": lambda: setattr(bluez, "forgets_after_scan", argument == "on"),
        "die": bluez.die,
        "rise": bluez.rise,
        "kill_bus": bluez.kill_bus,
    }
    try:
        commands[command]()
    except (ConfigError, LookupError, ValueError) as error:
        return f"{line}: {error!r}"
    return "ok"


def _fault(text: str, devices: dict[str, VirtualDevice]) -> None:
    scheduled = parse_fault(f"{text}@0s")
    devices[scheduled.sensor].apply(scheduled.fault)


def _say(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    main()
