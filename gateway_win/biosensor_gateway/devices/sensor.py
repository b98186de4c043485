"""The record of one sensor: its declaration, its driver, its virtual device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from biosensor_common.spec import SensorSpec


@dataclass(frozen=True, slots=True)
class Sensor:
    """What the folder of a sensor offers as its ``SENSOR``.

    Driver and virtual devices are named, ``module:attribute``, and imported when they are
    used: a list of sensors needs none of their libraries.

    Attributes
    ----------
    spec
        The declaration: streams, channels, units, rates.
    driver
        A :class:`~biosensor_gateway.devices.driver.DriverEntry`.
    virtual
        Classes of virtual devices by variant, ``""`` the
        usual one; what ``run --simulate`` calls ``zephyr`` and ``zephyr:recording``.
    demo
        The variant that the demo runs.
    introduces
        Whether ``try`` begins with it: the few whose signals most people look for.
    service
        The vendor's program by which its devices are reached; empty if there is none.
    precedence
        Of two sensors that recognise the same device, the one with more gets it: a generic
        sensor has less than 0.
    """

    spec: SensorSpec
    driver: str
    virtual: Mapping[str, str] = field(default_factory=dict[str, str])
    demo: str = ""
    introduces: bool = False
    service: str = ""
    precedence: int = 0
