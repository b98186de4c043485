"""Virtual devices in a process of their own, steered by lines of JSON.

    python -m tests.rigs.lab '[{"key": "a", "sensor": "polar_h10", "options": {"seed": 1}}]'

The first line that it prints says how to reach the devices; then each line of its
standard input is a command and is answered by one line.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from importlib import import_module
from typing import Any

import numpy as np

from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.simulation.world import World
from tests.rigs.bluez import FakeBluez

CLASSES = {
    "empatica_e4": "SimulatedE4",
    "emotiv_insight": "SimulatedCortex",
    "shimmer3_gsr": "SimulatedShimmer3",
    "polar_h10": "SimulatedPolarH10",
    "vernier_respiration_belt": "SimulatedBelt",
    "zephyr": "SimulatedZephyr",
    "ble_heart_rate": "SimulatedHeartRateStrap",
}
ON_AIR = frozenset({"polar_h10", "vernier_respiration_belt", "ble_heart_rate"})


def _make(world: World, radio: Radio | None, device: Mapping[str, Any]) -> VirtualDevice:
    module = import_module(f"biosensor_gateway.devices.{device['sensor']}.simulator")
    twin_class = getattr(module, CLASSES[device["sensor"]])
    place = (world, radio) if device["sensor"] in ON_AIR else (world,)
    return twin_class(*place, **device.get("options", {}))


class Lab:
    """The devices, and the air and Bluetooth daemon if any of them needs them."""

    def __init__(self, devices: list[dict[str, Any]], stack: ExitStack) -> None:
        self._world = stack.enter_context(World())
        self._bluez: FakeBluez | None = None
        radio: Radio | None = None
        if ON_AIR & {device["sensor"] for device in devices}:
            radio = Radio(self._world)
            self._bluez = stack.enter_context(FakeBluez(radio))
        self._twins = {
            device["key"]: stack.enter_context(_make(self._world, radio, device))
            for device in devices
        }

    def describe(self) -> dict[str, Any]:
        environment = dict(self._bluez.environment) if self._bluez else {}
        for twin in self._twins.values():
            environment |= twin.environment
        return {
            "environment": environment,
            "settings": {key: dict(twin.settings) for key, twin in self._twins.items()},
            "faults": {
                key: sorted(kind.value for kind in twin.faults) for key, twin in self._twins.items()
            },
        }

    def obey(self, command: dict[str, Any]) -> dict[str, Any]:
        twin = self._twins[command["key"]]
        match command["do"]:
            case "apply":
                twin.apply(Fault(FaultKind(command["kind"]), command["value"]))
            case "clear":
                twin.clear(FaultKind(command["kind"]))
            case "truth":
                self._save_truth(twin, command["path"])
            case "call":
                getattr(twin, command["method"])(**command["options"])
            case other:
                raise ValueError(f"what is {other!r}?")
        return {}

    @staticmethod
    def _save_truth(twin: VirtualDevice, path: str) -> None:
        arrays: dict[str, Any] = {}
        for name in twin.truth.data_names:
            samples = twin.truth.samples(name)
            arrays[f"{name}.times"], arrays[f"{name}.values"] = samples.times, samples.values
        np.savez(path, **arrays)


def main() -> None:
    with ExitStack() as stack:
        lab = Lab(json.loads(sys.argv[1]), stack)
        print(json.dumps(lab.describe()), flush=True)
        for line in sys.stdin:
            try:
                answer = lab.obey(json.loads(line))
            except Exception as error:  # noqa: BLE001 - whoever gave the command gets its error
                answer = {"error": f"{type(error).__name__}: {error}"}
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
