"""A session with one headset: made, subscribed to, closed."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence

from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError
from biosensor_gateway.devices.driver import own_settings
from biosensor_gateway.devices.emotiv_insight.driver import results
from biosensor_gateway.devices.emotiv_insight.driver.account import Account
from biosensor_gateway.devices.emotiv_insight.driver.codes import (
    SESSION_EXISTS,
    SESSION_NOT_ACTIVE,
    ErrorKind,
)
from biosensor_gateway.devices.emotiv_insight.driver.cortex import CortexClient, CortexError
from biosensor_gateway.devices.emotiv_insight.driver.failures import gateway_error
from biosensor_gateway.devices.emotiv_insight.driver.results import (
    Headset,
    SessionState,
    Subscription,
)
from biosensor_gateway.devices.emotiv_insight.driver.settings import EmotivInsightSettings
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.websocket import WebSocketLink

STREAMS = ("eeg", "mot", "dev", "pow", "met")
"""What the declaration has a place for."""
STOP_TIMEOUT_S = 0.5
EEG_NOT_LICENSED = "the licence does not cover raw EEG; the other streams go on"
STREAM_REFUSED = "Cortex refuses a stream; the others go on"

EXPIRED = "it has expired"
NO_RAW_EEG = "it does not cover raw EEG: eeg and eeg_status stay empty"
SLOW_METRICS = "it does not cover performance metrics: met comes every 10 s, not twice a second"


async def unlicensed(settings: DeviceSettings) -> Sequence[str]:
    """Sign in, without drawing sessions from a counted licence, and ask.

    Raises
    ------
    CredentialError
        ``MISSING``: a client id or secret, a user, an approval; ``REJECTED``.
    ProtocolError, TransportError
        See :meth:`CortexClient.call`.
    """
    own = own_settings(EmotivInsightSettings, settings)
    client = CortexClient(WebSocketLink(own.url, own.ca_file))
    account = Account(own.license)
    try:
        await client.open()
        await account.sign_in(client, patience_s=0.0)
        licence = results.licence(await account.call(client, "getLicenseInfo", {}))
    except CortexError as error:
        raise gateway_error(error) from error
    finally:
        await client.close()
    found = [EXPIRED] if licence.expired else []
    found += [NO_RAW_EEG] if "eeg" not in licence.scopes else []
    return found + ([SLOW_METRICS] if "pm" not in licence.scopes else [])


class Session:
    """One session; make it with `open_session`."""

    def __init__(self, client: CortexClient, account: Account, state: SessionState) -> None:
        self._client = client
        self._account = account
        self.session_id = state.session_id
        self.is_active = state.is_active

    async def subscribe(self, streams: Sequence[str] = STREAMS) -> Subscription:
        """Ask for streams; those that are refused are told once a device, the others go on.

        Raises
        ------
        ProtocolError
            ``REFUSED``: not a single stream is to be had.
        CortexError, TransportError
            See :meth:`CortexClient.call`.
        """
        try:
            subscription = await self._subscribe(streams)
        except CortexError as error:
            if not self._may_be_eeg(error) or "eeg" not in streams:
                raise
            # Refused as a whole: the licensed stream is what the licence can be about.
            self._account.say_once(EEG_NOT_LICENSED, code=error.code)
            subscription = await self._subscribe([each for each in streams if each != "eeg"])
        for stream, code in subscription.failures.items():
            if stream == "eeg":
                self._account.say_once(EEG_NOT_LICENSED, code=code)
            else:
                self._account.say_once(STREAM_REFUSED, stream=stream, code=code)
        if not subscription.layouts:
            message = "Cortex refuses every stream; look at the headset in EMOTIV Launcher"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        return subscription

    async def stop(self) -> None:
        """Unsubscribe and close the session, without waiting for the replies; never raises."""
        session = {"session": self.session_id}
        with contextlib.suppress(TransportError, TimeoutError):
            async with asyncio.timeout(STOP_TIMEOUT_S):
                await self._send("unsubscribe", {**session, "streams": list(STREAMS)})
                await self._send("updateSession", {**session, "status": "close"})

    def _may_be_eeg(self, error: CortexError) -> bool:
        """Tell whether a refusal can be about the licensed stream alone."""
        if error.code == SESSION_NOT_ACTIVE:
            return not self.is_active
        return error.kind in (ErrorKind.LICENSE, ErrorKind.STREAM)

    async def _subscribe(self, streams: Sequence[str]) -> Subscription:
        params = {"session": self.session_id, "streams": list(streams)}
        return results.subscription(await self._account.call(self._client, "subscribe", params))

    async def _send(self, method: str, params: dict[str, object]) -> None:
        await self._client.send(method, self._account.with_token(params))


async def open_session(client: CortexClient, account: Account, headset: Headset) -> Session:
    """Make a session: an active one if the licence allows, else one without licensed streams.

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
        return results.session(await account.call(client, "createSession", params))
    except CortexError as error:
        if error.code != SESSION_EXISTS:
            raise
        own = results.sessions(await account.call(client, "querySessions", {}))
        usable = [each for each in own
                  if each.headset_id == headset.headset_id and not each.is_closed]  # fmt: skip
        if not usable:
            raise
    if usable[0].is_active or status == "open":
        return usable[0]
    params = {"session": usable[0].session_id, "status": status}
    return results.session(await account.call(client, "updateSession", params))
