"""Getting a Shimmer ready to measure skin conductance and pulse."""

from __future__ import annotations

from typing import NamedTuple

import structlog

from biosensor_gateway.devices.shimmer.driver import commands
from biosensor_gateway.devices.shimmer.driver.channels import Channel
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer.driver.flash import (
    ask_for_the_state,
    expansion_board,
    make_right,
)
from biosensor_gateway.devices.shimmer.driver.kind import Kind
from biosensor_gateway.devices.shimmer.driver.messages import Inquiry
from biosensor_gateway.devices.shimmer3_gsr.driver.emitter import Measurement

GSR_BOARDS = frozenset({14, 48})

_log = structlog.get_logger("biosensor_gateway.shimmer3_gsr")


class Wanted(NamedTuple):
    """How to measure: sampling divisor, and feedback resistor (4 for automatic)."""

    divisor: int
    gsr_setting: int


async def set_up(talk: Conversation, kind: Kind, wanted: Wanted, name: str) -> Measurement:
    """Make the device measure skin conductance and pulse as wanted; it does not start yet.

    Settings are written to the device's flash, so what is right already is left alone.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if it does not take a setting, or as :meth:`Conversation.ask`.
    TransportError
        As :meth:`Conversation.ask`.
    """
    board = await expansion_board(talk, name)
    if board is not None and board not in GSR_BOARDS:
        # It measures, but nothing that makes sense.
        _log.warning("the expansion board is no GSR+ board", port=name, board=board)
    await ask_for_the_state(talk, kind)
    present = await make_right(talk, lambda inquiry: _changes(inquiry, wanted), name)
    return Measurement(kind.layout(present.channels), wanted.divisor, wanted.gsr_setting)


def _changes(present: Inquiry, wanted: Wanted) -> dict[str, bytes]:
    """Return the commands that are needed, by what they set."""
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
