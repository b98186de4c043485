"""Reads from a Shimmer's memory how its sensors are calibrated."""

from __future__ import annotations

from collections.abc import Mapping

import structlog

from biosensor_common.errors import ProtocolError
from biosensor_gateway.devices.shimmer.driver import calibration, commands
from biosensor_gateway.devices.shimmer.driver.calibration import Kinematic, Typical
from biosensor_gateway.devices.shimmer.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer.driver.kind import SHIMMER3R, Kind
from biosensor_gateway.devices.shimmer.driver.messages import (
    Calibration,
    Inquiry,
    PressureChip,
    PressureCoefficients,
)
from biosensor_gateway.devices.shimmer.driver.pressure import are_real
from biosensor_gateway.devices.shimmer.driver.signals import MOTION, motion_on

_log = structlog.get_logger("biosensor_gateway.shimmer")

_OLDER_CHIPS: Mapping[str, Typical] = {
    "acc_low_noise": calibration.KXRB5_ACCEL,
    "acc_wide_range": calibration.LSM303DLHC_ACCEL,
    "gyro": calibration.MPU9150_GYRO,
    "mag": calibration.LSM303DLHC_MAG,
}
_NEWER_CHIPS: Mapping[str, Typical] = {
    "acc_low_noise": calibration.KXTC9_ACCEL,
    "acc_wide_range": calibration.LSM303AH_ACCEL,
    "gyro": calibration.MPU9150_GYRO,
    "mag": calibration.LSM303AH_MAG,
}
_CHIPS_OF_3R: Mapping[str, Typical] = {
    "acc_low_noise": calibration.LSM6DSV_ACCEL,
    "acc_wide_range": calibration.LIS2DW12_ACCEL,
    "gyro": calibration.LSM6DSV_GYRO,
    "mag": calibration.LIS2MDL_MAG,
}


async def pressure_coefficients(talk: Conversation, kind: Kind) -> PressureCoefficients | None:
    """Return the coefficients of the device's pressure sensor; None if it does not tell.

    Raises
    ------
    TransportError
        As :meth:`Conversation.ask`.
    """
    asked = [commands.GET_BMP180_COEFFICIENTS, commands.GET_BMP280_COEFFICIENTS]
    if kind.tells_pressure_chip:
        asked = [commands.GET_PRESSURE_COEFFICIENTS]
    try:
        for command in asked:
            coefficients = await talk.ask(command, PressureCoefficients)
            # One that needs no coefficients has none.
            if coefficients.chip == PressureChip.BMP581 or are_real(coefficients):
                return coefficients
    except ProtocolError as error:
        _log.warning("the pressure sensor is unknown", cause=str(error))
    return None


async def motion_calibrations(
    talk: Conversation,
    kind: Kind,
    layout: Layout,
    present: Inquiry,
    air: PressureCoefficients | None,
) -> list[tuple[str, Kinematic]]:
    """Return the calibration of each motion sensor of which packets have values.

    It is the one in the device's memory; what has none there gets the typical values of its
    chip, which is said.

    Parameters
    ----------
    talk, kind, layout
    present
        How the device is set up, with the ranges of its sensors.
    air
        Tells which generation of chips it is, if known.

    Raises
    ------
    TransportError
        As :meth:`Conversation.ask`.
    """
    names = motion_on(layout)
    memory = await _memory(talk) if names else b""
    found = {name: calibration.stored(memory, MOTION[name].block) for name in names}
    without = [name for name, each in found.items() if each is None]
    if without:
        _log.warning("typical values calibrate what was never calibrated", streams=without)
    typical = typical_calibrations(kind, layout, present, air)
    return [(name, found[name] or each) for name, each in typical]


def typical_calibrations(
    kind: Kind, layout: Layout, present: Inquiry, air: PressureCoefficients | None
) -> list[tuple[str, Kinematic]]:
    """Return what the makers say of the chips of which packets have values, in their ranges.

    Parameters are those of `motion_calibrations`.
    """
    chips, ranges = _chips(kind, layout, air), _ranges(kind, present)
    return [(name, chips[name].at(ranges[name])) for name in motion_on(layout)]


async def _memory(talk: Conversation) -> bytes:
    try:
        return (await talk.ask(commands.GET_ALL_CALIBRATION, Calibration)).data
    except ProtocolError as error:
        _log.warning("the device does not tell its calibration", cause=str(error))
        return b""


def _chips(kind: Kind, layout: Layout, air: PressureCoefficients | None) -> Mapping[str, Typical]:
    if kind.hardware == SHIMMER3R:
        return _CHIPS_OF_3R
    has_newer_mag = Channel.MAG_X in layout.channels and not layout.has_older_mag
    # Both were replaced at once.
    has_newer_air = air is not None and air.chip == PressureChip.BMP280
    return _NEWER_CHIPS if has_newer_mag or has_newer_air else _OLDER_CHIPS


def _ranges(kind: Kind, present: Inquiry) -> dict[str, int]:
    """Return the settings of the ranges; the layout is that of the firmware's configuration."""
    setup = present.setup
    gyro = setup[2] & 3
    is_3r = kind.hardware == SHIMMER3R
    if is_3r:
        gyro |= (setup[4] >> 2 & 1) << 2
    return {
        "acc_low_noise": setup[3] >> 6 if is_3r else 0,
        "acc_wide_range": setup[0] >> 2 & 3,
        "gyro": gyro,
        "mag": 0 if is_3r else setup[2] >> 5,
    }
