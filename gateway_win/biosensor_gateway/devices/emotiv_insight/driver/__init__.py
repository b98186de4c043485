"""Driver for the Emotiv Insight, which connects through the Cortex service."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Sequence
from ipaddress import ip_address
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import structlog
from pydantic import Field, ValidationInfo, field_validator

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.spec import IRREGULAR, DeviceInfo
from biosensor_gateway.devices.driver import Connected, DriverEntry, Found, own_settings
from biosensor_gateway.devices.emotiv_insight.driver import account as accounts
from biosensor_gateway.devices.emotiv_insight.driver import protocol
from biosensor_gateway.devices.emotiv_insight.driver.account import (
    SECRETS,
    Account,
    find_credentials,
)
from biosensor_gateway.devices.emotiv_insight.driver.cortex import (
    ArrivedData,
    CortexClient,
    CortexError,
)
from biosensor_gateway.devices.emotiv_insight.driver.emitter import (
    EEG_RATE_HZ,
    GYROSCOPE,
    MOTION_RATE_HZ,
    EmotivEmitter,
)
from biosensor_gateway.devices.emotiv_insight.driver.messages import Fault
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Decoder, Headset, Subscription
from biosensor_gateway.devices.emotiv_insight.driver.session import (
    EEG_NOT_LICENSED,
    ENDINGS,
    STREAM_REFUSED,
    Session,
    ending,
    gateway_error,
    is_insight,
    known_headsets,
    open_session,
    reach,
    search,
)
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.tap import text_link_of
from biosensor_gateway.transports.websocket import WebSocketLink

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

DEFAULT_URL = "wss://localhost:6868"


class EmotivInsightSettings(DeviceSettings):
    """Settings of one Insight.

    The client id and secret of the Cortex app are not settings; they come from the environment or
    the keyring.
    """

    headset: str = Field(
        default="",
        description="Id of the headset as EMOTIV Launcher shows it, INSIGHT-A1B2C3D4 for instance; "
        "* matches any characters. If empty, the only one in range.",
    )
    allow_remote: bool = Field(
        default=False,
        description="Whether Cortex may run on another computer, which then gets the client id and "
        "secret.",
    )
    url: str = Field(
        default=DEFAULT_URL,
        description="Address of the Cortex service. Its certificate is for localhost, not for "
        "127.0.0.1.",
    )
    ca_file: str = Field(
        default="",
        description="PEM file of the vendor's root certificate. If empty, the certificates that "
        "the operating system trusts; on Windows, its installer adds this one.",
    )
    license: str = Field(
        default="",
        description="Id of the Emotiv licence to use. If empty, the one that Cortex chooses.",
    )
    debit: int = Field(
        default=10,
        ge=0,
        description="How many sessions to take from a metered licence at a time.",
    )

    @field_validator("url")
    @classmethod
    def _check_url(cls, url: str, info: ValidationInfo) -> str:
        parts = urlsplit(url)
        if parts.scheme != "wss" or not parts.hostname or parts.username is not None:
            raise ValueError(f"should look like {DEFAULT_URL}")
        if not (info.data.get("allow_remote") or is_loopback(parts.hostname)):
            raise ValueError("should be this computer, unless allow_remote is true")
        return url


def is_loopback(host: str) -> bool:
    """Whether a host name or address always means this computer."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


PATIENCE_S = 10.0
WHY_TIMEOUT_S = 2.0
STREAMS = {"eeg": ("eeg", "eeg_status"), "mot": ("mot", "gyro"), "pow": ("pow",), "dev": ("dev",)}
"""Streams that are monitored for each subscription; metrics come at irregular times."""
DUE = {"dev": 15.0}
"""Battery and contact are sent twice a second."""

_log = structlog.get_logger("biosensor_gateway.emotiv_insight")
SEARCH_S = 10.0


class EmotivInsightDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    silence_limit_s = 15.0

    def __init__(
        self,
        settings: EmotivInsightSettings,
        sink: DeviceSink,
        emitter: EmotivEmitter,
        account: Account,
    ) -> None:
        self._pattern = settings.headset
        self._sink = sink
        self._emitter = emitter
        self._account = account
        link = text_link_of(WebSocketLink(settings.url, settings.ca_file))
        self._client = CortexClient(link)
        self._endings = self._client.warnings.watch(*ENDINGS)
        self._decoder = Decoder()
        self._headset = Headset("")
        self._session: Session | None = None

    async def connect(self) -> Connected:
        """Sign in, find the headset, create a session and subscribe; see the protocol class."""
        await self._client.open()
        try:
            return await self._start()
        except CortexError as error:
            raise gateway_error(error) from error

    async def stream(self) -> None:
        """Emit data received since the subscription."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._pass_on())
                tasks.create_task(self._heed_warnings())
        except ExceptionGroup as group:
            # When the link ends, several tasks may fail with the same error.
            raise group.exceptions[0] from None

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Query the headset's state, and subscribe again; see the protocol class."""
        if self._session is None:
            raise RuntimeError("a driver streams after it has connected")
        silent = [each for each, names in STREAMS.items() if not streams.isdisjoint(names)]
        try:
            known = await known_headsets(self._client, WHY_TIMEOUT_S)
            self._require_connected(known)
            subscription = await self._session.subscribe(silent)
        except CortexError as error:
            raise gateway_error(error) from error
        self._take_layouts(self._session, subscription)

    def _require_connected(self, known: Sequence[Headset]) -> None:
        own = [each for each in known if each.headset_id == self._headset.headset_id]
        if not any(each.is_connected for each in own):
            reason = "Cortex has lost the headset; is it on, charged and near?"
            message = f"{self._headset.headset_id}: {reason}"
            raise TransportError(TransportReason.SILENT, message)

    async def close(self) -> None:
        """Close the session and the connection without waiting for replies."""
        if self._session is not None:
            await self._session.stop()
        await self._client.close()

    async def _start(self) -> Connected:
        client = self._client
        version = protocol.version(await client.call("getCortexInfo"))
        await self._account.sign_in(client, accounts.PATIENCE_S)
        headset, stayed = await reach(client, self._pattern)
        self._headset = headset
        self._forget_endings()
        self._session = await open_session(client, self._account, headset)
        subscription = await self._session.subscribe()
        self._take_layouts(self._session, subscription)
        eeg_rate = headset.eeg_rate_hz if headset.eeg_rate_hz > 0 else EEG_RATE_HZ
        motion_rate = headset.motion_rate_hz if headset.motion_rate_hz > 0 else MOTION_RATE_HZ
        self._emitter.connected(eeg_rate, motion_rate, headset_stayed=stayed)
        _log.info(
            "Cortex streams",
            unit=self._sink.identity.unit,
            headset=headset.headset_id,
            firmware=headset.firmware,
            virtual=headset.is_virtual,
            cortex=version,
            streams=sorted(subscription.layouts),
        )
        return Connected(
            DeviceInfo(serial_number=headset.headset_id, firmware_version=headset.firmware),
            {
                "eeg": eeg_rate,
                "eeg_status": eeg_rate,
                "mot": motion_rate,
                "gyro": motion_rate if _has_gyroscope(subscription) else IRREGULAR,
            },
            refused=_not_delivered(subscription),
            denied=_denied(subscription),
            due=DUE,
            patience_s=PATIENCE_S,
        )

    def _take_layouts(self, session: Session, subscription: Subscription) -> None:
        self._decoder.subscribed(
            subscription.session_id or session.session_id, subscription.layouts
        )
        self._emitter.offered({name: each.labels for name, each in subscription.layouts.items()})

    def _forget_endings(self) -> None:
        """Discard warnings from before the headset was connected."""
        while not self._endings.empty():
            self._endings.get_nowait()

    async def _pass_on(self) -> None:
        while True:
            arrived = await self._client.next_data()
            self._take(arrived)
            self._count_dropped()

    def _take(self, arrived: ArrivedData) -> None:
        sample = self._decoder.decode(arrived.data)
        if isinstance(sample, Fault):
            self._sink.dropped_bytes += arrived.size
            self._client.note(sample)
            return
        self._sink.heard()
        self._emitter.take(sample, arrived.arrival)

    def _count_dropped(self) -> None:
        self._sink.dropped_bytes += self._client.dropped_bytes
        self._client.dropped_bytes = 0

    async def _heed_warnings(self) -> None:
        session_id = self._session.session_id if self._session is not None else ""
        while True:
            error = ending(await self._endings.get(), self._headset.headset_id, session_id)
            if error is not None:
                raise error


def _not_delivered(subscription: Subscription) -> frozenset[str]:
    """Return the streams that the licence or the headset does not provide."""
    missing = STREAMS.keys() - subscription.layouts.keys() - subscription.failures.keys()
    return frozenset(name for stream in missing for name in STREAMS[stream])


def _denied(subscription: Subscription) -> dict[str, str]:
    """Return why Cortex refuses streams, by data name."""
    return {
        name: EEG_NOT_LICENSED if stream == "eeg" else f"{STREAM_REFUSED} {stream}, {code}"
        for stream, code in subscription.failures.items()
        for name in STREAMS.get(stream, (stream,))
        if name != "gyro"
    }


def _has_gyroscope(subscription: Subscription) -> bool:
    """Whether the motion stream has angular rates, as in older firmware."""
    motion = subscription.layouts.get("mot")
    return motion is not None and not motion.labels.isdisjoint(GYROSCOPE)


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], EmotivInsightDriver]:
    """Share the token and the emitter between all connections."""
    own = own_settings(EmotivInsightSettings, settings)
    emitter = EmotivEmitter(sink)
    account = Account(own.license, own.debit)
    return lambda: EmotivInsightDriver(own, sink, emitter, account)


EXPIRED = "it has expired"
NO_RAW_EEG = "it does not cover raw EEG: eeg and eeg_status stay empty"
SLOW_METRICS = "it does not cover performance metrics: met comes every 10 s, not twice a second"


async def unlicensed(settings: DeviceSettings) -> Sequence[str]:
    """Query what the licence does not cover, without using up sessions of a counted licence.

    Raises
    ------
    CredentialError
        ``MISSING`` client id or secret, user or approval; ``REJECTED``.
    ProtocolError, TransportError
        See :meth:`CortexClient.call`.
    """
    own = own_settings(EmotivInsightSettings, settings)
    client = CortexClient(WebSocketLink(own.url, own.ca_file))
    account = Account(own.license)
    try:
        await client.open()
        await account.sign_in(client, patience_s=0.0)
        licence = protocol.licence(await account.call(client, "getLicenseInfo", {}))
    except CortexError as error:
        raise gateway_error(error) from error
    finally:
        await client.close()
    found = [EXPIRED] if licence.expired else []
    found += [NO_RAW_EEG] if "eeg" not in licence.scopes else []
    return found + ([SLOW_METRICS] if "pm" not in licence.scopes else [])


async def find(configured: Sequence[DeviceSettings]) -> list[Found]:
    """Return the headsets in range of the services in the settings, or of the default service.

    Raises
    ------
    CredentialError
        If the client id or secret, login or approval is missing.
    TransportError
        ``ABSENT``: no Cortex service runs there.
    ProtocolError
        If Cortex refuses or does not answer.
    """
    await find_credentials()
    services = {_service(each) for each in configured} or {(DEFAULT_URL, "")}
    found: list[Found] = []
    for url, ca_file in sorted(services):
        for each in await _headsets(url, ca_file):
            if is_insight(each):
                found.append(_found(url, ca_file, each))
            else:
                _log.warning(
                    "a headset is not an Insight and cannot be used", headset=each.headset_id
                )
    return found


def _service(settings: DeviceSettings) -> tuple[str, str]:
    values = settings.model_dump()
    return values["url"], values["ca_file"]


async def _headsets(url: str, ca_file: str) -> list[Headset]:
    client = CortexClient(WebSocketLink(url, ca_file))
    try:
        await client.open()
        # A search does not wait for the user to log in.
        await Account().sign_in(client, patience_s=0.0)
        return await search(client, SEARCH_S, lambda _: False)
    except CortexError as error:
        raise gateway_error(error) from error
    finally:
        await client.close()


def _found(url: str, ca_file: str, headset: Headset) -> Found:
    settings: dict[str, str | int | float | bool] = {
        "unit": headset.headset_id,
        "headset": headset.headset_id,
    }
    if url != DEFAULT_URL:
        settings["url"] = url
        settings["allow_remote"] = not is_loopback(urlsplit(url).hostname or "")
    if ca_file:
        settings["ca_file"] = ca_file
    return Found("emotiv_insight", headset.name or headset.headset_id, settings)


_TELLS_NOTHING = (
    "jsonrpc|method|streamName|status|command|connectedBy|firmware|firmwareDisplay|version|mode|"
    "buildDate|buildNumber|behavior|apiName|displayedName|shortDisplayedName|name"
)
_KEY = rf'"(?!(?:{_TELLS_NOTHING})")\w+"\s*:\s*'
_MODEL = "(?![A-Z][A-Z0-9]*-[0-9A-F]{8})"
IDENTIFIERS = (
    re.compile(rb'"(?:cortexToken|clientId|clientSecret)"\s*:\s*"(?P<secret>[^"]+)"'),
    # Only the number of a headset's id is replaced; the model stays, because it is needed.
    re.compile(rb"[A-Z][A-Z0-9]*-([0-9A-F]{8})"),
    re.compile(rf'{_KEY}"{_MODEL}((?:[^"\\]|\\.){{8,}})"'.encode()),
    re.compile(rf'{_KEY}("(?:[^"\\]|\\.){{1,7}}")'.encode()),
)
"""All texts with exceptions; short ones include their quotation marks to exclude numbers."""
DRIVER = DriverEntry(
    EmotivInsightSettings,
    _make,
    find=find,
    secrets=SECRETS,
    unlicensed=unlicensed,
    identifiers=IDENTIFIERS,
)
