"""Getting a Shimmer ready: which sensors are on, and how their values are calibrated."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import structlog

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.shimmer.driver import commands, exg
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer.driver.emitter import Measurement
from biosensor_gateway.devices.shimmer.driver.exg import Exg, Registers, Use
from biosensor_gateway.devices.shimmer.driver.flash import (
    ask_for_the_state,
    expansion_board,
    make_right,
    refuse_if_left,
)
from biosensor_gateway.devices.shimmer.driver.kind import Kind
from biosensor_gateway.devices.shimmer.driver.memory import (
    motion_calibrations,
    pressure_coefficients,
)
from biosensor_gateway.devices.shimmer.driver.messages import ExgRegisters, Inquiry
from biosensor_gateway.devices.shimmer.driver.pressure import compensation
from biosensor_gateway.devices.shimmer.driver.signals import (
    Signal,
    air_signals,
    exg_signal,
    has_air,
    has_exg,
    motion_signals,
    sensor,
    status_places,
)

EXG_BOARDS = frozenset({37, 47, 59})

_log = structlog.get_logger("biosensor_gateway.shimmer")


class Wanted(NamedTuple):
    """How to measure.

    Attributes
    ----------
    sensors
        Names of `SENSORS`; None leaves on what is on.
    divisor
        32768 Hz divided by the sampling rate; None leaves it.
    bits, gain, lead_off
        Of the ExG where `sensors` has one.
    """

    sensors: frozenset[str] | None = None
    divisor: int | None = None
    bits: int = 24
    gain: int | None = None
    lead_off: bool = False

    @property
    def use(self) -> Use | None:
        """What the ExG chips are wanted for."""
        return next((use for use in Use if use in (self.sensors or ())), None)


async def set_up(talk: Conversation, kind: Kind, wanted: Wanted, name: str) -> Measurement:
    """Make the device measure as wanted, and find out how it measures; it does not start yet.

    Settings are written to the device's flash, so what is right already is left alone.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if it does not take a setting; ``UNSUPPORTED`` if nothing is on that can be
        read; or as :meth:`Conversation.ask`.
    TransportError
        As :meth:`Conversation.ask`.
    """
    await ask_for_the_state(talk, kind)
    present = await make_right(talk, partial(_changes, wanted=wanted), name)
    if wanted.use is not None:
        await _set_exg_up(talk, wanted, wanted.use, present, name)
    layout = kind.layout(present.channels)
    signals = await _calibrated(talk, kind, layout, present)
    chips = Exg(await _registers(talk)) if has_exg(layout) else None
    if chips is not None:
        signals.insert(0, exg_signal(layout, chips))
        if chips.is_test_signal:
            _log.warning("the ExG measures a test signal", port=name)
    if not signals:
        message = f"{name}: none of its sensors is on that can be read; set sensors"
        raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
    tells = chips is not None and chips.detects_lead_off and chips.use is Use.ECG
    status_at = status_places(layout) if tells else None
    return Measurement(layout, present.divisor, tuple(signals), status_at)


async def _calibrated(
    talk: Conversation, kind: Kind, layout: Layout, present: Inquiry
) -> list[Signal]:
    """Return the streams of motion and air sensors, calibrated from the device's memory."""
    air = await pressure_coefficients(talk, kind) if has_air(layout) else None
    motion = await motion_calibrations(talk, kind, layout, present, air)
    signals = motion_signals(layout, motion)
    compensate = air and compensation(air, present.pressure_oversampling)
    if compensate:
        signals += air_signals(layout, compensate)
    return signals


def _changes(present: Inquiry, wanted: Wanted) -> dict[str, bytes]:
    """Return the commands that are needed, by what they set."""
    changes: dict[str, bytes] = {}
    if wanted.sensors is not None:
        on = [sensor(each, wanted.bits) for each in sorted(wanted.sensors)]
        if set(present.channels) != {channel for each in on for channel in each.channels}:
            changes["sensors"] = commands.set_sensors(sum(each.mask for each in on))
    if wanted.divisor not in (None, present.divisor):
        changes["sampling rate"] = commands.set_sampling_rate(wanted.divisor)
    return changes


async def _registers(talk: Conversation) -> Registers:
    first = await talk.ask(commands.get_exg_registers(0), ExgRegisters)
    second = await talk.ask(commands.get_exg_registers(1), ExgRegisters)
    return first.data.ljust(exg.REGISTERS, b"\0"), second.data.ljust(exg.REGISTERS, b"\0")


async def _set_exg_up(
    talk: Conversation, wanted: Wanted, use: Use, present: Inquiry, name: str
) -> None:
    board = await expansion_board(talk, name)
    if board is not None and board not in EXG_BOARDS:
        # It measures, but nothing that makes sense.
        _log.warning("the expansion board is no ExG board", port=name, board=board)
    gain = wanted.gain or exg.DEFAULT_GAIN[use]
    rate_hz = commands.TICKS_PER_S / present.divisor
    right = exg.registers_for(use, gain, rate_hz, lead_off=wanted.lead_off)
    changes = _exg_changes(await _registers(talk), right)
    for command in changes.values():
        await talk.tell(command)
    if changes:
        refuse_if_left(_exg_changes(await _registers(talk), right), name)


def _exg_changes(present: Registers, right: Registers) -> dict[str, bytes]:
    return {
        f"ExG chip {chip + 1}": commands.set_exg_registers(chip, right[chip])
        for chip in (0, 1)
        if not exg.are_same(present[chip], right[chip])
    }
