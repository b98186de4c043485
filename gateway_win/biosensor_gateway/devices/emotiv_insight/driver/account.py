"""Signs in to Cortex: waits for a user and the user's approval, and gets a token."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass

import structlog

from biosensor_common.errors import (
    CredentialError,
    CredentialReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.emotiv_insight.driver import protocol
from biosensor_gateway.devices.emotiv_insight.driver.cortex import CortexClient, CortexError, until
from biosensor_gateway.devices.emotiv_insight.driver.messages import ErrorKind, Event, Warned
from biosensor_gateway.settings.secrets import Secret, SecretName, find_secret
from biosensor_gateway.system.device_log import Once
from biosensor_gateway.transports.threads import in_daemon_thread

PATIENCE_S = 60.0
"""How long one connection attempt waits for the user."""
ASK_EVERY_S = 5.0
AUTHORIZE_TIMEOUT_S = 30.0
RETRY_HEADSET_S = 2.0
RETRIES = 3

CLIENT_ID = SecretName(
    "emotiv_insight", "client_id", "EMOTIV_CLIENT_ID", "the client id of the Cortex app"
)
CLIENT_SECRET = SecretName(
    "emotiv_insight", "client_secret", "EMOTIV_CLIENT_SECRET", "the client secret of the Cortex app"
)
SECRETS = (CLIENT_ID, CLIENT_SECRET)

_log = structlog.get_logger("biosensor_gateway.emotiv_insight")


@dataclass(frozen=True, slots=True)
class Credentials:
    """The credentials of this application for Cortex."""

    client_id: Secret
    client_secret: Secret

    def params(self) -> dict[str, object]:
        """Return client id and secret as parameters of a request."""
        return {"clientId": self.client_id, "clientSecret": self.client_secret}


async def find_credentials() -> Credentials:
    """Look up the client id and secret.

    Raises
    ------
    CredentialError
        ``MISSING``.
    """
    client_id, client_secret = await in_daemon_thread(
        lambda: (find_secret(CLIENT_ID), find_secret(CLIENT_SECRET))
    )
    return Credentials(client_id, client_secret)


class Account:
    """The sign-in of a device at Cortex; one per device, over all its connections.

    The token is reused, because a new one may use up sessions of a counted licence.

    Parameters
    ----------
    license_id
        Licence id; empty for the one that Cortex chooses.
    debit
        Sessions to take from a counted licence with each token.
    """

    def __init__(self, license_id: str = "", debit: int = 0) -> None:
        self._license_id = license_id
        self._debit = debit
        self._token: Secret | None = None
        self._credentials: Credentials | None = None
        self._authorizing = asyncio.Lock()
        self._is_new = Once()

    async def sign_in(self, client: CortexClient, patience_s: float) -> None:
        """Wait for a login and the user's approval, and get a token.

        Parameters
        ----------
        patience_s
            How long to wait for the user to log in or approve.

        Raises
        ------
        CredentialError
            ``MISSING``: a client id or secret, a user, an approval; ``REJECTED``.
        TransportError
            ``BUSY`` if another user of this computer is logged in to Cortex.
        CortexError
            If Cortex refuses for another reason.
        """
        self._credentials = await find_credentials()
        client.warnings.hide(self._credentials.client_id.reveal())
        client.warnings.hide(self._credentials.client_secret.reveal())
        if self._token is not None:
            client.warnings.hide(self._token.reveal())
        await self._await_login(client, patience_s)
        await self._await_approval(client, self._credentials, patience_s)
        if self._token is None:
            await self._authorize(client)

    async def call(self, client: CortexClient, method: str, params: Mapping[str, object]) -> object:
        """Call a method that needs the token; get a new one if it has expired.

        Raises
        ------
        CortexError, ProtocolError, TransportError
            See :meth:`CortexClient.call`.
        """
        token = self._token
        try:
            return await self._call_patiently(client, method, params)
        except CortexError as error:
            if error.kind is not ErrorKind.TOKEN:
                raise
        async with self._authorizing:
            # Another call may have renewed the token meanwhile.
            if self._token is token:
                await self._authorize(client)
        return await self._call_patiently(client, method, params)

    def with_token(self, params: Mapping[str, object]) -> dict[str, object]:
        """Return parameters with the token added."""
        return {"cortexToken": self._token or "", **params}

    def say_once(self, sentence: str, **details: object) -> None:
        """Log a sentence once per device and details."""
        if self._is_new(sentence, str(details)):
            _log.warning(sentence, **details)

    async def _call_patiently(
        self, client: CortexClient, method: str, params: Mapping[str, object]
    ) -> object:
        for _ in range(RETRIES):
            try:
                return await client.call(method, self.with_token(params))
            except CortexError as error:
                if error.kind is not ErrorKind.RETRY_HEADSET:
                    raise
                await asyncio.sleep(RETRY_HEADSET_S)
        return await client.call(method, self.with_token(params))

    async def _authorize(self, client: CortexClient) -> None:
        if self._credentials is None:
            raise RuntimeError("authorizing comes after signing in")
        params: dict[str, object] = {**self._credentials.params(), "debit": self._debit}
        if self._license_id:
            params["license"] = self._license_id
        result = await client.call("authorize", params, AUTHORIZE_TIMEOUT_S)
        self._token = Secret(protocol.token(result))
        client.warnings.hide(self._token.reveal())
        if protocol.eula_missing(result):
            self.say_once("the licence agreement is not accepted; accept it in EMOTIV Launcher")

    async def _await_login(self, client: CortexClient, patience_s: float) -> None:
        missing = "nobody is logged in to EMOTIV Launcher; log in there"

        async def ask(_: Warned | None) -> bool | None:
            login = protocol.login(await client.call("getUserLogin"))
            if not login.same_os_user:
                message = "another user of this computer is logged in to EMOTIV Launcher; log out"
                raise TransportError(TransportReason.BUSY, message)
            if not login.logged_in:
                self.say_once(missing)
            return login.logged_in or None

        with client.warnings.watching(Event.USER_LOGIN) as heard:
            if not await until(ask, heard, every_s=ASK_EVERY_S, patience_s=patience_s):
                raise CredentialError(CredentialReason.MISSING, missing)

    async def _await_approval(
        self, client: CortexClient, credentials: Credentials, patience_s: float
    ) -> None:
        missing = "this application awaits its approval in EMOTIV Launcher; click Approve there"
        requested = False

        async def ask(warned: Warned | None) -> bool | None:
            nonlocal requested
            if warned is not None and warned.event is Event.ACCESS_REJECTED:
                message = "the use of Emotiv headsets was rejected in EMOTIV Launcher; allow it"
                raise CredentialError(CredentialReason.REJECTED, message)
            method = "hasAccessRight"
            granted = protocol.access_granted(await client.call(method, credentials.params()))
            if not granted and not requested:
                requested = True
                method = "requestAccess"
                granted = protocol.access_granted(await client.call(method, credentials.params()))
                if not granted:
                    self.say_once(missing)
            return granted or None

        with client.warnings.watching(Event.ACCESS_GRANTED, Event.ACCESS_REJECTED) as heard:
            if not await until(ask, heard, every_s=ASK_EVERY_S, patience_s=patience_s):
                raise CredentialError(CredentialReason.MISSING, missing)
