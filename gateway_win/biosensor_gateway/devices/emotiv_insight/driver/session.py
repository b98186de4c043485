"""Finds the headset, manages the session, and maps Cortex errors to the agent's errors."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import NamedTuple

from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    CredentialError,
    CredentialReason,
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.emotiv_insight import SPEC
from biosensor_gateway.devices.emotiv_insight.driver import protocol
from biosensor_gateway.devices.emotiv_insight.driver.account import Account
from biosensor_gateway.devices.emotiv_insight.driver.cortex import CortexClient, CortexError, until
from biosensor_gateway.devices.emotiv_insight.driver.messages import (
    SESSION_EXISTS,
    SESSION_NOT_ACTIVE,
    ErrorKind,
    Event,
    Warned,
)
from biosensor_gateway.devices.emotiv_insight.driver.protocol import (
    Headset,
    SessionState,
    Subscription,
)

ELECTRODES = SPEC.stream("eeg").labels
"""Electrodes of an Insight, as in the declaration."""
# Prefix of ids, which begin with the model: ``INSIGHT-``, ``INSIGHT2-``, ``EPOCX-`` ...
_FAMILY = "INSIGHT"
SCAN_PATIENCE_S = 25.0
"""A scan takes about 20 s."""
CONNECT_PATIENCE_S = 30.0
ASK_EVERY_S = 2.0


class Reached(NamedTuple):
    """A headset that is connected to Cortex.

    ``stayed`` is True if it was connected already, and so has measured all the time.
    """

    headset: Headset
    stayed: bool


async def known_headsets(client: CortexClient, timeout_s: float = 0.0) -> list[Headset]:
    """Return the headsets that Cortex knows now; see :meth:`CortexClient.call`."""
    return protocol.headsets(await client.call("queryHeadsets", timeout_s=timeout_s))


async def reach(client: CortexClient, pattern: str) -> Reached:
    """Find the headset and connect it to Cortex.

    Parameters
    ----------
    pattern
        Id, with ``*`` for any characters; empty for the only headset.

    Raises
    ------
    TransportError
        ``ABSENT``.
    ConfigError
        ``WRONG_VALUE`` if more than one headset matches.
    CortexError, ProtocolError
        If Cortex refuses or does not answer; ``UNSUPPORTED`` if the headset is not an Insight.
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
    """Return the headset that matches a pattern; None if there is none.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if more than one matches.
    ProtocolError
        ``UNSUPPORTED`` if no match is an Insight.
    """
    fitting = _fitting(headsets, pattern)
    insights = [each for each in fitting if is_insight(each)]
    if len(insights) > 1:
        ids = ", ".join(sorted(each.headset_id for each in insights))
        message = f"{len(insights)} headsets match; set headset to one of {ids}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    if fitting and not insights:
        _require_insight(fitting[0])
    return insights[0] if insights else None


def is_insight(headset: Headset) -> bool:
    """Whether a headset has the declared channels, as far as known."""
    if headset.electrodes:
        return set(headset.electrodes) == set(ELECTRODES)
    return headset.headset_id.upper().startswith(_FAMILY)


async def search(
    client: CortexClient, patience_s: float, is_enough: Callable[[Sequence[Headset]], bool]
) -> list[Headset]:
    """Let Cortex search for headsets until enough are found; return all known headsets.

    There is no search while any headset is connected, because it would disturb streaming.
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
        f"{headset.headset_id} is not an Insight{channels}; only the Insight's channels are known "
        "here, so set headset to an Insight"
    )
    raise ProtocolError(ProtocolReason.UNSUPPORTED, message)


def _has_insight(headsets: Sequence[Headset], pattern: str) -> bool:
    return any(is_insight(each) for each in _fitting(headsets, pattern))


def _fitting(headsets: Sequence[Headset], pattern: str) -> list[Headset]:
    return [each for each in headsets if fnmatchcase(each.headset_id, pattern or "*")]


_ABSENT = TransportReason.ABSENT
_LOST = TransportReason.LOST
_MISSING = CredentialReason.MISSING
_REJECTED = CredentialReason.REJECTED

_ERRORS: dict[ErrorKind, tuple[TransportReason | CredentialReason, str]] = {
    ErrorKind.CREDENTIALS: (_REJECTED, "check the client id and secret of the Cortex app"),
    ErrorKind.TOKEN: (_REJECTED, "log out of EMOTIV Launcher and in again"),
    ErrorKind.USER: (_MISSING, "log in to EMOTIV Launcher"),
    ErrorKind.ACCESS: (_MISSING, "approve this application in EMOTIV Launcher"),
    ErrorKind.LICENSE: (
        _REJECTED,
        "check the licence; a Cortex app that requires EEG needs a licence with EEG",
    ),
    ErrorKind.HEADSET: (_ABSENT, "switch the headset on, near this computer"),
    ErrorKind.RETRY_HEADSET: (_ABSENT, "wait until EMOTIV Launcher shows it as ready"),
    ErrorKind.SESSION: (_LOST, "the session is opened again"),
}

ENDINGS = {
    Event.SUBSCRIPTIONS_STOPPED: (_LOST, "Cortex has stopped the streams"),
    Event.SESSION_CLOSED: (_LOST, "Cortex has closed the session"),
    Event.HEADSET_LOST: (_LOST, "Cortex has lost the headset; is it on, charged and near?"),
    Event.CLIENT_UNKNOWN: (_LOST, "Cortex asks for a new connection"),
    Event.USER_LOGOUT: (_MISSING, "the user has logged out of EMOTIV Launcher; log in there"),
    Event.OTHER_OS_USER: (
        TransportReason.BUSY,
        "another user of this computer has logged in to EMOTIV Launcher",
    ),
}
"""Warnings that end a connection, with reason and advice."""


def gateway_error(error: CortexError) -> GatewayError:
    """Return the matching error with advice, or the same error if retrying is enough."""
    found = _ERRORS.get(error.kind)
    return error if found is None else _error(found[0], f"{error}; {found[1]}")


def ending(warned: Warned, headset_id: str, session_id: str) -> GatewayError | None:
    """Return the error for a warning that ends this connection, else None."""
    if warned.session not in ("", session_id) or warned.headset not in ("", headset_id):
        return None
    found = ENDINGS.get(warned.event)
    return None if found is None else _error(*found)


def _error(reason: TransportReason | CredentialReason, message: str) -> GatewayError:
    if isinstance(reason, TransportReason):
        return TransportError(reason, message)
    return CredentialError(reason, message)


STREAMS = ("eeg", "mot", "dev", "pow", "met")
"""Cortex streams used by the declaration."""
STOP_TIMEOUT_S = 0.5
EEG_NOT_LICENSED = "the EMOTIV licence does not cover raw EEG"
STREAM_REFUSED = "Cortex does not give its stream"


class Session:
    """One session, created by `open_session`."""

    def __init__(self, client: CortexClient, account: Account, state: SessionState) -> None:
        self._client = client
        self._account = account
        self.session_id = state.session_id
        self.is_active = state.is_active

    async def subscribe(self, streams: Sequence[str] = STREAMS) -> Subscription:
        """Subscribe to streams; refused ones are listed in the failures of the result.

        Raises
        ------
        ProtocolError
            ``REFUSED`` if no stream is available.
        CortexError, TransportError
            See :meth:`CortexClient.call`.
        """
        try:
            subscription = await self._subscribe(streams)
        except CortexError as error:
            if not self._may_be_eeg(error) or "eeg" not in streams:
                raise
            # If all are refused because of the licence, only EEG can be the cause, so retry
            # without it.
            others = await self._subscribe([each for each in streams if each != "eeg"])
            failures = {**others.failures, "eeg": error.code}
            subscription = replace(others, failures=failures)
        if not subscription.layouts:
            message = "Cortex refuses every stream; check the headset in EMOTIV Launcher"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        return subscription

    async def stop(self) -> None:
        """Unsubscribe and close the session without waiting for replies; never raises."""
        session = {"session": self.session_id}
        with contextlib.suppress(TransportError, TimeoutError):
            async with asyncio.timeout(STOP_TIMEOUT_S):
                await self._send("unsubscribe", {**session, "streams": list(STREAMS)})
                await self._send("updateSession", {**session, "status": "close"})

    def _may_be_eeg(self, error: CortexError) -> bool:
        """Whether a refusal can be caused by the licensed stream alone."""
        if error.code == SESSION_NOT_ACTIVE:
            return not self.is_active
        return error.kind in (ErrorKind.LICENSE, ErrorKind.STREAM)

    async def _subscribe(self, streams: Sequence[str]) -> Subscription:
        params = {"session": self.session_id, "streams": list(streams)}
        return protocol.subscription(await self._account.call(self._client, "subscribe", params))

    async def _send(self, method: str, params: dict[str, object]) -> None:
        await self._client.send(method, self._account.with_token(params))


async def open_session(client: CortexClient, account: Account, headset: Headset) -> Session:
    """Create a session: an active one if licensed, else one without licensed streams.

    Raises
    ------
    CortexError, ProtocolError, TransportError
        See :meth:`CortexClient.call`.
    """
    try:
        state = await _create(client, account, headset, "active")
    except CortexError as error:
        if error.kind is not ErrorKind.LICENSE:
            raise
        account.say_once("the licence does not allow an active session", code=error.code)
        state = await _create(client, account, headset, "open")
    return Session(client, account, state)


async def _create(
    client: CortexClient, account: Account, headset: Headset, status: str
) -> SessionState:
    params = {"headset": headset.headset_id, "status": status}
    try:
        return protocol.session(await account.call(client, "createSession", params))
    except CortexError as error:
        if error.code != SESSION_EXISTS:
            raise
        own = protocol.sessions(await account.call(client, "querySessions", {}))
        usable = [each for each in own
                  if each.headset_id == headset.headset_id and not each.is_closed]  # fmt: skip
        if not usable:
            raise
    if usable[0].is_active or status == "open":
        return usable[0]
    params = {"session": usable[0].session_id, "status": status}
    return protocol.session(await account.call(client, "updateSession", params))
