"""Finding the headset, and getting Cortex to connect to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.emotiv_insight.declaration import SPEC
from biosensor_gateway.devices.emotiv_insight.driver import results
from biosensor_gateway.devices.emotiv_insight.driver.codes import Event
from biosensor_gateway.devices.emotiv_insight.driver.cortex import CortexClient
from biosensor_gateway.devices.emotiv_insight.driver.messages import Warned
from biosensor_gateway.devices.emotiv_insight.driver.results import Headset
from biosensor_gateway.devices.emotiv_insight.driver.waiting import until

ELECTRODES = SPEC.stream("eeg").labels
"""Of an Insight, and so of all that is declared."""
_FAMILY = "INSIGHT"
"""Ids begin with the model: ``INSIGHT-``, ``INSIGHT2-``, ``EPOCX-``, ``MN8-`` ..."""
SCAN_PATIENCE_S = 25.0
"""A scan takes about 20 s."""
CONNECT_PATIENCE_S = 30.0
ASK_EVERY_S = 2.0


class Reached(NamedTuple):
    """A headset that is connected to Cortex.

    ``stayed`` tells whether it was so already, and so has measured all the time.
    """

    headset: Headset
    stayed: bool


async def known_headsets(client: CortexClient, timeout_s: float = 0.0) -> list[Headset]:
    """Ask Cortex which headsets it knows now; see :meth:`CortexClient.call`."""
    return results.headsets(await client.call("queryHeadsets", timeout_s=timeout_s))


async def reach(client: CortexClient, pattern: str) -> Reached:
    """Find the headset and have it connected.

    Parameters
    ----------
    pattern
        Id, with ``*`` for any characters; empty for the only one.

    Raises
    ------
    TransportError
        ``ABSENT``.
    ConfigError
        ``WRONG_VALUE``: more than one headset fits.
    CortexError, ProtocolError
        Cortex refuses or does not answer; ``UNSUPPORTED``: the headset is no Insight.
    """
    known = await search(client, SCAN_PATIENCE_S, lambda found: _has_insight(found, pattern))
    found = chosen(known, pattern)
    if found is None:
        message = f"Cortex finds no headset {pattern or 'at all'}; switch it on, near this computer"
        raise TransportError(TransportReason.ABSENT, message)
    if found.is_connected:
        return Reached(found, stayed=True)
    return Reached(await _connect(client, found), stayed=False)


def chosen(headsets: Sequence[Headset], pattern: str) -> Headset | None:
    """Return the headset that a pattern means, None if there is none.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``: more than one fits, and which it is must not be left to chance.
    ProtocolError
        ``UNSUPPORTED``: none that fits is an Insight.
    """
    fitting = _fitting(headsets, pattern)
    insights = [each for each in fitting if is_insight(each)]
    if len(insights) > 1:
        ids = ", ".join(sorted(each.headset_id for each in insights))
        message = f"{len(insights)} headsets fit; set headset to one of {ids}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    if fitting and not insights:
        _require_insight(fitting[0])
    return insights[0] if insights else None


def is_insight(headset: Headset) -> bool:
    """Tell whether a headset has the channels of the declaration, as far as it tells its own."""
    if headset.electrodes:
        return set(headset.electrodes) == set(ELECTRODES)
    return headset.headset_id.upper().startswith(_FAMILY)


async def search(
    client: CortexClient, patience_s: float, is_enough: Callable[[Sequence[Headset]], bool]
) -> list[Headset]:
    """Let Cortex search until enough is found or it has finished; return all that it knows then.

    A search disturbs what is streaming, so there is none while any headset is connected.
    """
    known = await known_headsets(client)
    if is_enough(known) or any(each.is_connected for each in known):
        return known

    async def ask(warned: Warned | None) -> list[Headset] | None:
        found = await known_headsets(client)
        return found if warned is not None or is_enough(found) else None

    with client.warnings.watching(Event.SCAN_FINISHED) as heard:
        await client.call("controlDevice", {"command": "refresh"})
        found = await until(ask, heard, every_s=ASK_EVERY_S, patience_s=patience_s)
    return found if found is not None else known


async def _connect(client: CortexClient, found: Headset) -> Headset:
    message = f"Cortex cannot connect to {found.headset_id}; is it on, charged and near?"
    own = found.headset_id

    async def ask(warned: Warned | None) -> Headset | None:
        if (
            warned is not None
            and warned.event is Event.HEADSET_CONNECT_FAILED
            and warned.headset in (own, "")
        ):
            raise TransportError(TransportReason.ABSENT, message)
        known = chosen(await known_headsets(client), own)
        return known if known is not None and known.is_connected else None

    with client.warnings.watching(Event.HEADSET_CONNECTED, Event.HEADSET_CONNECT_FAILED) as heard:
        if found.status != "connecting":
            params = {"command": "connect", "headset": own}
            await client.call("controlDevice", params, CONNECT_PATIENCE_S)
        connected = await until(ask, heard, every_s=ASK_EVERY_S, patience_s=CONNECT_PATIENCE_S)
    if connected is None:
        raise TransportError(TransportReason.ABSENT, message)
    return connected


def _require_insight(headset: Headset) -> None:
    if is_insight(headset):
        return
    own = headset.electrodes
    channels = f" ({len(own)} electrodes: {', '.join(own)})" if own else ""
    message = (
        f"{headset.headset_id} is no Insight{channels}; only the Insight's channels are known "
        "here, so set headset to an Insight"
    )
    raise ProtocolError(ProtocolReason.UNSUPPORTED, message)


def _has_insight(headsets: Sequence[Headset], pattern: str) -> bool:
    return any(is_insight(each) for each in _fitting(headsets, pattern))


def _fitting(headsets: Sequence[Headset], pattern: str) -> list[Headset]:
    return [each for each in headsets if fnmatchcase(each.headset_id, pattern or "*")]
