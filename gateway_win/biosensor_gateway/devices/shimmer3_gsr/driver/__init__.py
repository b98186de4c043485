"""Driver for the Shimmer3 GSR+, and its settings."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple

import structlog
from pydantic import Field

from biosensor_gateway.devices.driver import Connected, DriverEntry, by_port_name, own_settings
from biosensor_gateway.devices.shimmer.driver import commands
from biosensor_gateway.devices.shimmer.driver.channels import Channel
from biosensor_gateway.devices.shimmer.driver.connection import Prepared, ShimmerDriver
from biosensor_gateway.devices.shimmer.driver.conversation import (
    Conversation,
    Kind,
    ask_for_the_state,
    expansion_board,
    make_right,
)
from biosensor_gateway.devices.shimmer.driver.messages import Inquiry
from biosensor_gateway.devices.shimmer3_gsr import SPEC
from biosensor_gateway.devices.shimmer3_gsr.driver.emitter import WAVEFORMS, GsrEmitter, Measurement
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings

GSR_BOARDS = frozenset({14, 48})

_log = structlog.get_logger("biosensor_gateway.shimmer3_gsr")


class ShimmerSettings(DeviceSettings):
    """Settings of one Shimmer3 GSR+."""

    port: str = Field(
        min_length=1,
        description="Serial port of the paired Shimmer, COM7 or /dev/rfcomm0 for instance, or its "
        "Bluetooth address, 00:06:66:AA:BB:CC for instance, or socket://HOST:NUMBER.",
        examples=["/dev/rfcomm0"],
    )
    rate_hz: float = Field(
        default=128.0,
        ge=51.2,
        le=1024.0,
        description="Sampling rate in Hz; the device takes the nearest rate that divides 32768.",
    )
    gsr_range: Literal["auto", 0, 1, 2, 3] = Field(
        default="auto",
        description="Range of the skin conductance: auto, or fixed to 0 (15.9 to 125 microsiemens),"
        " 1 (4.5 to 15.9), 2 (1.5 to 4.5) or 3 (0.2 to 1.5).",
    )


class Wanted(NamedTuple):
    """Wanted setup: sample rate divisor, and feedback resistor (4 for automatic)."""

    divisor: int
    gsr_setting: int


async def set_up(talk: Conversation, kind: Kind, wanted: Wanted, name: str) -> Measurement:
    """Set up the device for skin conductance and pulse, without starting it.

    Settings are written to the device's flash, so correct ones are not written again.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if it does not accept a setting, or as for :meth:`Conversation.ask`.
    TransportError
        As :meth:`Conversation.ask`.
    """
    board = await expansion_board(talk, name)
    if board is not None and board not in GSR_BOARDS:
        # It measures, but the values are meaningless.
        _log.warning("the expansion board is no GSR+ board", port=name, board=board)
    denied = await ask_for_the_state(talk, kind)
    present = await make_right(talk, lambda inquiry: _changes(inquiry, wanted), name)
    layout = kind.layout(present.channels)
    return Measurement(layout, wanted.divisor, wanted.gsr_setting, denied)


def _changes(present: Inquiry, wanted: Wanted) -> dict[str, bytes]:
    """Return the necessary commands by the setting that they change."""
    right = {
        "sensors": set(present.channels) == {Channel.GSR, Channel.PPG},
        "GSR range": present.gsr_range == wanted.gsr_setting,
        "power of the optical probe": present.expansion_power,
        "sampling rate": present.divisor == wanted.divisor,
    }
    setting = {
        "sensors": commands.set_sensors(commands.GSR_AND_PPG),
        "GSR range": commands.set_gsr_range(wanted.gsr_setting),
        "power of the optical probe": commands.POWER_THE_PROBE,
        "sampling rate": commands.set_sampling_rate(wanted.divisor),
    }
    return {name: command for name, command in setting.items() if not right[name]}


def _wanted(settings: ShimmerSettings) -> Wanted:
    setting = commands.AUTO_RANGE if settings.gsr_range == "auto" else settings.gsr_range
    return Wanted(commands.divisor_for(settings.rate_hz), setting)


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], ShimmerDriver]:
    """Share one emitter between all connections, to follow the device's clock across them."""
    own = own_settings(ShimmerSettings, settings)
    emitter = GsrEmitter(sink)
    wanted = _wanted(own)

    async def prepare(talk: Conversation, kind: Kind) -> Prepared:
        measurement = await set_up(talk, kind, wanted, own.port)
        rates = {
            name: measurement.rate_hz
            for name in WAVEFORMS
            if measurement.rate_hz != SPEC.stream(name).rate
        }
        begin = partial(emitter.started, measurement)
        connected = Connected(rates=rates, denied=measurement.denied)
        return Prepared(measurement.layout, measurement.divisor, begin, connected)

    return lambda: ShimmerDriver(own.port, sink, emitter, prepare)


recognise = by_port_name("shimmer3_gsr", r"Shimmer3-([0-9A-Fa-f]{4})")
DRIVER = DriverEntry(ShimmerSettings, _make, recognise=recognise)
