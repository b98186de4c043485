"""Charge of the battery from its voltage, by the vendor's table."""

from __future__ import annotations

import numpy as np

from biosensor_gateway.devices.shimmer.driver.adc import ADC_MAX, ADC_VOLTS
from biosensor_gateway.devices.shimmer.driver.messages import BatteryReading
from biosensor_gateway.devices.sink import Sink

_DIVIDER = 1.988
_CHARGER_CHECKS_ABOVE_VOLTS = 4.5

_VOLTS = (
    3.2, 3.627, 3.645, 3.663, 3.681, 3.699, 3.717, 3.7314, 3.735, 3.7386, 3.7566, 3.771, 3.789,
    3.8034, 3.8106, 3.8394, 3.861, 3.8826, 3.9078, 3.933, 3.969, 4.0086, 4.041, 4.0734, 4.113,
    4.167,
)  # fmt: skip
_PERCENT = (
    0, 5.9, 9.8, 13.8, 17.7, 21.6, 25.6, 29.5, 33.4, 37.4, 41.3, 45.2, 49.2, 53.1, 57, 61, 64.9,
    68.9, 72.8, 76.7, 80.7, 84.6, 88.5, 92.5, 96.4, 100,
)  # fmt: skip


def battery_volts(adc: int) -> float:
    """Return the battery's voltage; it is measured behind a divider."""
    return adc * ADC_VOLTS / ADC_MAX * _DIVIDER


def percent(volts: float) -> float:
    """Return the charge in percent, linear between the vendor's points and 0 to 100."""
    return float(np.interp(volts, _VOLTS, _PERCENT))


def charge_percent(reading: BatteryReading) -> float | None:
    """Return the charge in percent; None while the charger is testing the battery."""
    volts = battery_volts(reading.adc)
    return percent(volts) if volts <= _CHARGER_CHECKS_ABOVE_VOLTS else None


def emit_charge(sink: Sink, reading: BatteryReading, arrival_s: float) -> None:
    """Emit a battery reading as ``bat``; it has no time of its own.

    Parameters
    ----------
    arrival_s
        LSL clock when it came.
    """
    level = charge_percent(reading)
    if level is not None:
        sink.emit_at("bat", [level], [arrival_s])
