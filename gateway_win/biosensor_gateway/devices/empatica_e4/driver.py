"""The conversation with the E4 streaming server: find, bind, subscribe, pass on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import structlog
from pydantic import Field

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices import DriverEntry
from biosensor_gateway.devices.driver import Connected
from biosensor_gateway.devices.empatica_e4.conversation import Conversation
from biosensor_gateway.devices.empatica_e4.discovery import DEFAULT_HOST, DEFAULT_PORT, find
from biosensor_gateway.devices.empatica_e4.emitter import E4Emitter
from biosensor_gateway.devices.empatica_e4.messages import (
    Event,
    Malformed,
    Message,
    RadioEvent,
    Sample,
    Wristband,
)
from biosensor_gateway.devices.empatica_e4.protocol import SUBSCRIBED
from biosensor_gateway.settings import DeviceSettings
from biosensor_gateway.sink import DeviceSink

SILENCE_S = 3.0
"""Without a line for so long, the server is asked whether it is still there."""
DATA_SILENCE_S = 10.0
RADIO_GRACE_S = 30.0
LIST_TIMEOUT_S, BIND_TIMEOUT_S, RADIO_TIMEOUT_S = 3.0, 5.0, 30.0
DISCOVERABLE_MINUTES = "208"
"""How long a wristband may be looked for after its radio was lost; what other clients use."""

_ALREADY_BOUND = "same connection"
_log = structlog.get_logger("biosensor_gateway.empatica_e4")


class E4Settings(DeviceSettings):
    """Settings of one E4 wristband."""

    host: str = Field(
        default=DEFAULT_HOST,
        min_length=1,
        description="Computer on which the E4 streaming server runs.",
    )
    port: int = Field(
        default=DEFAULT_PORT, ge=1, le=65535, description="TCP port of the E4 streaming server."
    )
    device: str = Field(
        default="",
        pattern="^([0-9A-Fa-f]{6})?$",
        description="Id of the wristband, six hex digits such as 9ff167; empty takes the only one "
        "on the server.",
    )


class E4Driver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    # The driver has its own watchdogs; a wristband out of reach is silent for longer.
    silence_limit_s = RADIO_GRACE_S + 10.0

    def __init__(self, settings: E4Settings, sink: DeviceSink, emitter: E4Emitter) -> None:
        self._where = f"E4 server {settings.host}:{settings.port}"
        self._wanted = settings.device.lower()
        self._sink = sink
        self._emitter = emitter
        self._talk = Conversation(settings.host, settings.port)
        self._device = ""
        self._data_at = 0.0
        self._radio_lost_at: float | None = None

    async def connect(self) -> Connected:
        """Bind this TCP connection to the wristband and subscribe every stream."""
        await self._talk.open()
        self._device = (await self._listed() or await self._discovered()).device
        await self._bind()
        await self._talk.ask("pause", "ON", timeout_s=LIST_TIMEOUT_S)
        await self._subscribe()
        await self._talk.ask("pause", "OFF", timeout_s=LIST_TIMEOUT_S)
        self._emitter.new_epoch()
        return Connected(DeviceInfo(serial_number=self._device.upper()))

    async def stream(self) -> None:
        """Pass on samples; the watchdog asks the server when nothing comes."""
        self._data_at = asyncio.get_running_loop().time()
        while True:
            try:
                async with asyncio.timeout(SILENCE_S):
                    messages, arrival = await self._talk.receive()
            except TimeoutError:
                await self._probe()
                continue
            self._take(messages, arrival)

    async def close(self) -> None:
        """Unbind, which makes the server close the connection, and close."""
        # The rest of a line at the connection's end, and what made no sense before streaming.
        self._sink.dropped_bytes += self._talk.take_dropped_bytes()
        await self._talk.close()

    async def _listed(self) -> Wristband | None:
        reply = await self._talk.ask("device_list", timeout_s=LIST_TIMEOUT_S)
        return self._chosen(reply.devices)

    async def _discovered(self) -> Wristband:
        """Connect the wristband's radio, which a server without its window leaves to clients."""
        reply = await self._talk.ask("device_discover_list", timeout_s=LIST_TIMEOUT_S)
        found = self._chosen(reply.devices)
        if found is None:
            name = f"wristband {self._wanted}" if self._wanted else "wristband"
            message = f"{self._where}: it sees no {name}; switch it on, near the dongle"
            raise TransportError(TransportReason.ABSENT, message)
        if not found.allowed:
            message = (
                f"{self._where}: its API key does not own wristband {found.device}; "
                "use the key of the account where it is registered"
            )
            raise ProtocolError(ProtocolReason.REFUSED, message)
        answer = await self._talk.ask(
            "device_connect_btle", found.device, DISCOVERABLE_MINUTES, timeout_s=RADIO_TIMEOUT_S
        )
        if not answer.accepted:
            message = f"{self._where}: no radio link to {found.device} ({answer.reason})"
            raise TransportError(TransportReason.ABSENT, message)
        return found

    def _chosen(self, devices: tuple[Wristband, ...]) -> Wristband | None:
        if self._wanted:
            return next((each for each in devices if each.device == self._wanted), None)
        if len(devices) > 1:
            names = ", ".join(each.device for each in devices)
            message = f"{self._where}: it has several wristbands ({names}); set `device` to one"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        return devices[0] if devices else None

    async def _bind(self) -> None:
        reply = await self._talk.ask("device_connect", self._device, timeout_s=BIND_TIMEOUT_S)
        if not reply.accepted and _ALREADY_BOUND not in reply.reason:
            message = f"{self._where}: wristband {self._device} is refused ({reply.reason})"
            raise TransportError(TransportReason.ABSENT, message)

    async def _subscribe(self) -> None:
        refused: list[str] = []
        for stream in SUBSCRIBED:
            reply = await self._talk.ask(
                "device_subscribe", stream.value, "ON", timeout_s=LIST_TIMEOUT_S
            )
            if not reply.accepted:
                refused.append(stream.value)
        if len(refused) == len(SUBSCRIBED):
            message = f"{self._where}: every stream of {self._device} is refused; restart it"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        if refused:
            _log.warning("the server refuses streams", where=self._where, streams=refused)

    def _take(self, messages: list[Message], arrival: float) -> None:
        """Act on what came, in its order: an event divides the samples around it."""
        self._sink.dropped_bytes += self._talk.take_dropped_bytes()
        samples: list[Sample] = []
        for message in messages:
            if isinstance(message, Sample):
                samples.append(message)
            elif isinstance(message, Event) and message.device == self._device:
                self._pass_on(samples, arrival)
                samples.clear()
                self._radio(message.event)
            elif isinstance(message, Malformed):
                _log.debug("a line makes no sense", where=self._where, why=message.flaw.value)
        self._pass_on(samples, arrival)

    def _pass_on(self, samples: list[Sample], arrival: float) -> None:
        if samples:
            self._data_at = asyncio.get_running_loop().time()
            self._radio_lost_at = None
            self._sink.heard()
            self._emitter.take(samples, arrival)

    def _radio(self, event: RadioEvent) -> None:
        if event is RadioEvent.TURNED_OFF:
            self._emitter.switched_off()
            message = f"wristband {self._device} was switched off; press its button for 2 s"
            raise TransportError(TransportReason.ABSENT, message)
        if event is RadioEvent.LOST:
            self._radio_lost_at = asyncio.get_running_loop().time()
            _log.warning("the wristband is out of reach of its dongle", device=self._device)
        else:
            _log.info("the wristband is back", device=self._device)
        # Samples of the old link that are still on their way keep the old mapping.
        if event is RadioEvent.RESTORED:
            self._emitter.new_epoch()

    async def _probe(self) -> None:
        """Find out why nothing comes.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``, when waiting has no sense any more.
        """
        loop = asyncio.get_running_loop()
        if self._radio_lost_at is not None:
            if loop.time() - self._radio_lost_at > RADIO_GRACE_S:
                message = f"wristband {self._device} stays out of reach; bring it to the dongle"
                raise TransportError(TransportReason.LOST, message)
            return
        # The answer is looked for among data, which may begin again before it.
        answered = await self._talk.probe(self._take, LIST_TIMEOUT_S)
        if not answered:
            message = f"{self._where}: it says nothing any more; the connection is started anew"
            raise TransportError(TransportReason.SILENT, message)
        if loop.time() - self._data_at > DATA_SILENCE_S:
            message = f"{self._where}: no data from wristband {self._device}; is it still on?"
            raise TransportError(TransportReason.SILENT, message)


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], E4Driver]:
    """Share one emitter between all connections: it follows losses across them."""
    if not isinstance(settings, E4Settings):
        raise TypeError(f"not the settings of an E4: {type(settings).__name__}")
    emitter = E4Emitter(sink)
    return lambda: E4Driver(settings, sink, emitter)


DRIVER = DriverEntry(E4Settings, _make, find=find)
