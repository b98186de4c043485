"""Virtual devices in a process of their own, steered by lines of JSON.

    python -m tests.rigs.lab '[{"key": "a", "sensor": "polar_h10", "options": {"seed": 1}}]'

The first line that it prints says how to reach the devices; then each line of its
standard input is a command and is answered by one line.
"""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from typing import Any

import numpy as np

from biosensor_gateway.demo.virtual_devices import make
from biosensor_gateway.simulation.faults import Fault, FaultKind, Untidiness
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from tests.rigs.bluez.adapter import BluezScene
from tests.rigs.processes import before_others


class Lab:
    """The devices, and the air and Bluetooth daemon if any of them needs them."""

    def __init__(self, devices: list[dict[str, Any]], stack: ExitStack) -> None:
        self._scene = BluezScene(stack)
        self._devices = {
            device["key"]: stack.enter_context(
                make(device["sensor"], self._scene, **device.get("options", {}))
            )
            for device in devices
        }

    def describe(self) -> dict[str, Any]:
        bluez = self._scene.bluez
        environment = dict(bluez.environment) if bluez else {}
        for virtual in self._devices.values():
            environment |= virtual.environment
        return {
            "environment": environment,
            "settings": {key: dict(virtual.settings) for key, virtual in self._devices.items()},
            "faults": {
                key: sorted(kind.value for kind in virtual.faults)
                for key, virtual in self._devices.items()
            },
        }

    def obey(self, command: dict[str, Any]) -> dict[str, Any]:
        virtual = self._devices[command["key"]]
        match command["do"]:
            case "apply":
                virtual.apply(Fault(_kind(command["kind"]), command["value"]))
            case "clear":
                virtual.clear(_kind(command["kind"]))
            case "truth":
                self._save_truth(virtual, command["path"])
            case "call":
                getattr(virtual, command["method"])(**command["options"])
            case other:
                raise ValueError(f"what is {other!r}?")
        return {}

    @staticmethod
    def _save_truth(virtual: VirtualDevice, path: str) -> None:
        arrays: dict[str, Any] = {}
        for name in virtual.truth.data_names:
            samples = virtual.truth.samples(name)
            arrays[f"{name}.times"], arrays[f"{name}.values"] = samples.times, samples.values
        np.savez(path, **arrays)


def _kind(word: str) -> FaultKind | Untidiness:
    kinds: dict[str, FaultKind | Untidiness] = {e.value: e for e in (*FaultKind, *Untidiness)}
    return kinds[word]


def main() -> None:
    before_others()
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
