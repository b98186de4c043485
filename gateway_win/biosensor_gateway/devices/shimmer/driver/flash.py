"""Reads what a Shimmer keeps in its flash, and changes it only where it is not right."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import structlog

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.shimmer.driver import commands
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer.driver.kind import Kind
from biosensor_gateway.devices.shimmer.driver.messages import (
    BatteryReading,
    DaughterCard,
    Inquiry,
    Status,
)

_log = structlog.get_logger("biosensor_gateway.shimmer")


async def ask_for_the_state(talk: Conversation, kind: Kind) -> dict[str, str]:
    """Ask for status and battery, which whoever listens notes.

    Returns
    -------
    dict of str to str
        By data name, why the device does not tell.

    Raises
    ------
    ProtocolError, TransportError
        As :meth:`Conversation.ask`, but that the battery may be refused.
    """
    if kind.has_status:
        await talk.ask(commands.GET_STATUS, Status)
        try:
            await talk.ask(commands.GET_BATTERY, BatteryReading)
        except ProtocolError as error:
            if error.reason is not ProtocolReason.REFUSED:
                raise
            return {"bat": "it does not take the question for its voltage"}
    return {}


async def expansion_board(talk: Conversation, name: str) -> int | None:
    """Return the number of the expansion board; None if the device does not tell.

    Raises
    ------
    TransportError
        As :meth:`Conversation.ask`.
    """
    try:
        card = await talk.ask(commands.GET_DAUGHTER_CARD, DaughterCard)
    except ProtocolError as error:
        _log.warning("the expansion board is unknown", port=name, cause=str(error))
        return None
    return card.data[0] if card.data else None


async def make_right(
    talk: Conversation, changes_to: Callable[[Inquiry], Mapping[str, bytes]], name: str
) -> Inquiry:
    """Change what an inquiry shows to be wrong; return how the device is set up then.

    Parameters
    ----------
    changes_to
        Returns the commands that are needed, by what they set.
    name
        What error messages call the device.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if it does not take a setting, or as :meth:`Conversation.ask`.
    TransportError
        As :meth:`Conversation.ask`.
    """
    present = await talk.ask(commands.INQUIRY, Inquiry)
    changes = changes_to(present)
    for command in changes.values():
        await talk.tell(command)
    if changes:
        present = await talk.ask(commands.INQUIRY, Inquiry)
        refuse_if_left(changes_to(present), name)
    return present


def refuse_if_left(changes: Mapping[str, bytes], name: str) -> None:
    """Say what the device did not take.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if anything is left to be changed.
    """
    if changes:
        message = f"{name}: the device did not take {', '.join(changes)}; switch it off and on"
        raise ProtocolError(ProtocolReason.REFUSED, message)
