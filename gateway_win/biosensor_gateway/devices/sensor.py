"""The record of one sensor: its declaration, its driver, its virtual device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from biosensor_common.spec import SensorSpec


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor's registration, the ``SENSOR`` of its folder.

    Driver and virtual devices are given as ``module:attribute`` and imported when used, so that a
    list of sensors needs none of their libraries.
    """

    spec: SensorSpec  # The declaration: streams, channels, units, rates.
    driver: str  # A :class:`~biosensor_gateway.devices.driver.DriverEntry`.
    # Classes of virtual devices by variant, with `""` for the default; `run --simulate` accepts
    # them as `zephyr` and `zephyr:recording`.
    virtual: Mapping[str, str] = field(default_factory=dict[str, str])
    demo: str = ""  # The variant used in the demo.
    # Whether `try` starts with it; set for the few sensors most people want to see.
    introduces: bool = False
    service: str = ""  # The vendor's program that connects to its devices; empty if there is none.
    # If two sensors recognise the same device, the one with the higher value gets it; generic
    # sensors have negative values.
    precedence: int = 0
