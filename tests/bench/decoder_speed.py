"""How fast every decoder is, on what its driver fed it from a virtual device.

Each driver runs against its virtual device for some seconds while the calls of its decoder are
taped; then the tape is played to a new decoder, as fast as it goes.
"""

from __future__ import annotations

import asyncio
import statistics
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any
from unittest.mock import patch

from biosensor_gateway.demo.virtual_devices import simulated_settings
from biosensor_gateway.doctor import device_test

_PACKAGE = "biosensor_gateway.devices"

# Functions by the module that calls them; classes with their methods, and with the
# attributes that are set from outside.
_FUNCTIONS: dict[str, Sequence[tuple[str, str]]] = {
    "emotiv_insight": [("emotiv_insight.driver.cortex", "parse")],
    "polar_h10": [
        ("polar_h10.driver.emitter", "parse_frame"),
        ("ble_heart_rate.driver.emitter", "parse_measurement"),
    ],
    "polar_verity_sense": [("polar_h10.driver.emitter", "parse_frame")],
    "ble_heart_rate": [("ble_heart_rate.driver.emitter", "parse_measurement")],
}
_CLASSES: dict[str, tuple[str, str, frozenset[str], frozenset[str]]] = {
    "empatica_e4": ("empatica_e4.driver.protocol", "E4Protocol", frozenset({"feed"}), frozenset()),
    "emotiv_insight": (
        "emotiv_insight.driver.protocol",
        "Decoder",
        frozenset({"subscribed", "decode"}),
        frozenset(),
    ),
    "shimmer": (
        "shimmer.driver.protocol",
        "ShimmerProtocol",
        frozenset({"feed", "settle", "give_up", "expect_data"}),
        frozenset({"crc", "form"}),
    ),
    "shimmer3_gsr": (
        "shimmer.driver.protocol",
        "ShimmerProtocol",
        frozenset({"feed", "settle", "give_up", "expect_data"}),
        frozenset({"crc", "form"}),
    ),
    "vernier_respiration_belt": (
        "vernier_respiration_belt.driver.protocol",
        "VernierProtocol",
        frozenset({"feed"}),
        frozenset(),
    ),
    "zephyr": ("zephyr.driver.protocol", "ZephyrProtocol", frozenset({"feed"}), frozenset()),
}
SENSORS = tuple(dict.fromkeys((*_CLASSES, *_FUNCTIONS)))


@dataclass(slots=True)
class DecoderSpeed:
    """Speed of one sensor's decoder, as multiples of real time."""

    sensor: str
    taped_s: float
    best: float
    median: float


@dataclass(slots=True)
class _Tape:
    """Calls of one sensor's decoder, ready to be repeated."""

    calls: list[tuple[int, str, tuple[Any, ...]]] = field(default_factory=list[Any])
    functions: dict[str, Callable[..., Any]] = field(default_factory=dict[str, Any])
    make: Callable[[], Any] | None = None

    def play(self) -> float:
        """Repeat every call; return the seconds of processor time that it took."""
        instances: dict[int, Any] = {}
        begin = time.thread_time()
        for instance, name, arguments in self.calls:
            if name in self.functions:
                self.functions[name](*arguments)
                continue
            if instance not in instances:
                assert self.make is not None
                instances[instance] = self.make()
            if name.startswith("="):
                setattr(instances[instance], name[1:], *arguments)
            else:
                getattr(instances[instance], name)(*arguments)
        return time.thread_time() - begin


def measure(passes: int, taped_s: float) -> list[DecoderSpeed]:
    """Tape each decoder for so long, then play its tape so many times."""
    return [_measure(sensor, passes, taped_s) for sensor in SENSORS]


def _measure(sensor: str, passes: int, taped_s: float) -> DecoderSpeed:
    tape = _Tape()
    with _taping(sensor, tape), simulated_settings([sensor]) as settings:
        outcome = asyncio.run(device_test.run_device_test(settings.devices[0], taped_s))
    assert outcome.info is not None, outcome.problems
    multiples = [taped_s / tape.play() for _ in range(passes)]
    return DecoderSpeed(sensor, taped_s, max(multiples), statistics.median(multiples))


@contextmanager
def _taping(sensor: str, tape: _Tape) -> Generator[None]:
    with ExitStack() as stack:
        for module_name, name in _FUNCTIONS.get(sensor, ()):
            module = import_module(f"{_PACKAGE}.{module_name}")
            tape.functions[name] = getattr(module, name)
            taped = _taped_function(tape, name, tape.functions[name])
            stack.enter_context(patch.object(module, name, taped))
        if sensor in _CLASSES:
            module_name, name, methods, attributes = _CLASSES[sensor]
            decoder = getattr(import_module(f"{_PACKAGE}.{module_name}"), name)
            tape.make = decoder
            for method in methods:
                taped = _taped_method(tape, method, getattr(decoder, method))
                stack.enter_context(patch.object(decoder, method, taped))
            if attributes:
                taped = _taped_setter(tape, attributes)
                stack.enter_context(patch.object(decoder, "__setattr__", taped))
        yield


def _taped_function(tape: _Tape, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
    def taped(*arguments: object) -> object:
        tape.calls.append((0, name, arguments))
        return original(*arguments)

    return taped


def _taped_method(tape: _Tape, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
    def taped(self: object, *arguments: object) -> object:
        tape.calls.append((id(self), name, arguments))
        return original(self, *arguments)

    return taped


def _taped_setter(tape: _Tape, attributes: frozenset[str]) -> Callable[..., None]:
    def taped(self: object, name: str, value: object) -> None:
        # Those of the constructor are set again by every new decoder.
        if name in attributes and hasattr(self, name):
            tape.calls.append((id(self), f"={name}", (value,)))
        object.__setattr__(self, name, value)

    return taped
