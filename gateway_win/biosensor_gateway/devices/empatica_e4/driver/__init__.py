"""Driver for the Empatica E4, which connects through the E4 streaming server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TYPE_CHECKING

import structlog
from pydantic import Field

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import Connected, DriverEntry, Found, own_settings
from biosensor_gateway.devices.empatica_e4.driver.emitter import DATA_NAMES, E4Emitter
from biosensor_gateway.devices.empatica_e4.driver.protocol import (
    SUBSCRIBED,
    E4Protocol,
    Event,
    Malformed,
    Message,
    RadioEvent,
    Reply,
    Sample,
    Stream,
    Wristband,
    request,
)
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.byte_links import tcp_link
from biosensor_gateway.transports.dialogue import Dialogue, Heard

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

PATIENCE_S = 5.0
SHOWN = 60
"""Number of characters of an unusable line shown in the log."""
RADIO_GRACE_S = 30.0
LIST_TIMEOUT_S, BIND_TIMEOUT_S, RADIO_TIMEOUT_S = 3.0, 5.0, 30.0
DISCOVERABLE_MINUTES = "208"
"""How long a lost wristband stays discoverable; the value used by other clients."""

_ALREADY_BOUND = "same connection"
_log = structlog.get_logger("biosensor_gateway.empatica_e4")
DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 28000
_TIMEOUT_S = 3.0

_LISTS = ("device_list", "device_discover_list")


class _Conversation:
    """One TCP connection to a server."""

    def __init__(self, host: str, port: int) -> None:
        self._where = f"E4 server {host}:{port}"
        self._link = tcp_link(host, port)
        self._protocol = E4Protocol()
        self._dialogue = Dialogue(self._receive, self._link.write)
        self._reported_bytes = 0

    async def open(self) -> None:
        """Connect; raises like :meth:`ByteLink.open`."""
        try:
            await self._link.open()
        except TransportError as error:
            if error.reason is not TransportReason.ABSENT:
                raise
            message = f"{self._where}: nothing answers; start the E4 streaming server there"
            raise TransportError(TransportReason.ABSENT, message) from error
        self._dialogue.begin()

    async def ask(self, command: str, *arguments: str, timeout_s: float) -> Reply:
        """Send a request and wait for its reply.

        Raises
        ------
        ProtocolError
            ``NO_REPLY``.
        TransportError
            ``LOST``.
        """

        def answer(heard: Heard[Message]) -> Reply | None:
            message = heard.message
            return message if isinstance(message, Reply) and _answers(message, command) else None

        reply = await self._dialogue.ask(request(command, *arguments), answer, timeout_s)
        if reply is None:
            message = f"{self._where}: no answer to {command}; restart the server"
            raise ProtocolError(ProtocolReason.NO_REPLY, message)
        return reply

    def tell(self, command: str, *arguments: str) -> None:
        """Send a request without waiting for the reply."""
        self._link.write(request(command, *arguments))

    async def stream(self, listener: Callable[[Sequence[Heard[Message]]], None]) -> None:
        """Pass on all messages since `open`, grouped by read.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        await self._dialogue.stream(listener)

    def take_dropped_bytes(self) -> int:
        """Return the number of bytes dropped since the last call."""
        new = self._protocol.dropped_bytes - self._reported_bytes
        self._reported_bytes = self._protocol.dropped_bytes
        return new

    async def close(self) -> None:
        """Unbind without waiting for the reply, and close; never raises."""
        self.tell("device_disconnect")
        await self._dialogue.close()
        await self._link.close()

    async def _receive(self) -> list[Heard[Message]]:
        try:
            data, arrival = await self._link.read()
        except TransportError:
            self._protocol.finish()
            raise
        return [Heard(message, arrival) for message in self._protocol.feed(data)]


def _answers(message: Reply, command: str) -> bool:
    # According to the vendor's documentation, either list request may be answered with either
    # word.
    return message.command == command or (command in _LISTS and message.command in _LISTS)


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
        description="Id of the wristband, six hex digits such as 9ff167; if empty, the only one on "
        "the server.",
    )


class E4Driver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    # A wristband out of range is silent for longer than the limit of its streams.
    silence_limit_s = RADIO_GRACE_S + 10.0

    def __init__(self, settings: E4Settings, sink: DeviceSink, emitter: E4Emitter) -> None:
        self._where = f"E4 server {settings.host}:{settings.port}"
        self._wanted = settings.device.lower()
        self._sink = sink
        self._emitter = emitter
        self._talk = _Conversation(settings.host, settings.port)
        self._device = ""
        self._is_given_up = asyncio.Event()
        self._giving_up: asyncio.TimerHandle | None = None

    async def connect(self) -> Connected:
        """Bind this TCP connection to the wristband and subscribe to every stream."""
        await self._talk.open()
        self._device = (await self._listed() or await self._discovered()).device
        await self._bind()
        answers = await self._pause("ON")
        refused = await self._subscribe(SUBSCRIBED)
        if answers:
            await self._pause("OFF")
        else:
            # The pause may have taken effect even without a reply.
            self._talk.tell("pause", "OFF")
        self._emitter.new_epoch()
        info = DeviceInfo(serial_number=self._device.upper())
        denied = {DATA_NAMES.get(each, each.value): why for each, why in refused.items()}
        if Stream.IBI in refused:
            # The server sends heart rates with the intervals.
            denied[DATA_NAMES[Stream.HR]] = refused[Stream.IBI]
        return Connected(info, denied=denied, patience_s=PATIENCE_S)

    async def stream(self) -> None:
        """Emit data received since connecting."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._talk.stream(self._take))
            tasks.create_task(self._require_radio())

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Subscribe to silent streams again; see the protocol class."""
        silent = [each for each in SUBSCRIBED if DATA_NAMES.get(each) in streams]
        try:
            await self._subscribe(silent)
        except ProtocolError as error:
            says = "no longer sends anything"
            if error.reason is not ProtocolReason.NO_REPLY:
                says = f"gives no data from wristband {self._device}; is it still on?"
            message = f"{self._where}: it {says}; the connection is restarted"
            raise TransportError(TransportReason.SILENT, message) from error

    async def close(self) -> None:
        """Unbind, after which the server closes the connection, and close."""
        # Includes a partial line at the end, and invalid lines before streaming.
        self._sink.dropped_bytes += self._talk.take_dropped_bytes()
        await self._talk.close()

    async def _listed(self) -> Wristband | None:
        reply = await self._talk.ask("device_list", timeout_s=LIST_TIMEOUT_S)
        return self._chosen(reply.devices)

    async def _discovered(self) -> Wristband:
        """Connect the wristband's radio, which a server without a window leaves to its clients."""
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

    async def _pause(self, switch: str) -> bool:
        """Pause or resume data; return whether there was a reply."""
        # A pause is optional, because replies are also recognised among data.
        try:
            await self._talk.ask("pause", switch, timeout_s=LIST_TIMEOUT_S)
        except ProtocolError:
            self._emitter.log.warn_once("the server does not answer pause; continuing without it")
            return False
        return True

    async def _subscribe(self, streams: Collection[Stream]) -> dict[Stream, str]:
        """Subscribe to streams one by one; return why some are refused.

        Raises
        ------
        ProtocolError
            ``REFUSED`` if all are refused; ``NO_REPLY``.
        """
        refused: dict[Stream, str] = {}
        for stream in streams:
            reply = await self._talk.ask(
                "device_subscribe", stream.value, "ON", timeout_s=LIST_TIMEOUT_S
            )
            if not reply.accepted:
                refused[stream] = f"the server says: {reply.reason or 'no'}; restart the server"
        if len(refused) == len(streams):
            message = f"{self._where}: every stream of {self._device} is refused; restart it"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        return refused

    def _take(self, found: Sequence[Heard[Message]]) -> None:
        """Process messages in order, because an event separates the samples before and after it."""
        self._sink.dropped_bytes += self._talk.take_dropped_bytes()
        samples: list[Sample] = []
        arrival = found[-1].arrival_s if found else 0.0
        for message, _ in found:
            if isinstance(message, Sample):
                samples.append(message)
            elif isinstance(message, Event) and message.device == self._device:
                self._pass_on(samples, arrival)
                samples.clear()
                self._radio(message.event)
            elif isinstance(message, Malformed):
                self._emitter.log.warn_once(
                    "lines are dropped", cause=message.flaw.value, line=ascii(message.raw[:SHOWN])
                )
        self._pass_on(samples, arrival)

    def _pass_on(self, samples: list[Sample], arrival: float) -> None:
        if samples:
            self._wait_for_radio(None)
            self._sink.heard()
            self._emitter.take(samples, arrival)

    def _radio(self, event: RadioEvent) -> None:
        if event is RadioEvent.TURNED_OFF:
            self._emitter.switched_off()
            message = f"wristband {self._device} was switched off; press its button for 2 s"
            raise TransportError(TransportReason.ABSENT, message)
        if event is RadioEvent.LOST:
            self._wait_for_radio(RADIO_GRACE_S)
            _log.warning("the wristband is out of range of its dongle", device=self._device)
            self._sink.excuse(*DATA_NAMES.values())
        else:
            _log.info("the wristband is back", device=self._device)
        # Samples of the old link that arrive before this event keep the old mapping.
        if event is RadioEvent.RESTORED:
            self._emitter.new_epoch()

    def _wait_for_radio(self, limit_s: float | None) -> None:
        if self._giving_up is not None:
            self._giving_up.cancel()
            self._giving_up = None
        if limit_s is not None:
            loop = asyncio.get_running_loop()
            self._giving_up = loop.call_later(limit_s, self._is_given_up.set)

    async def _require_radio(self) -> None:
        """Raise ``LOST`` when the wristband has been out of range for too long."""
        await self._is_given_up.wait()
        message = f"wristband {self._device} stays out of range; bring it near the dongle"
        raise TransportError(TransportReason.LOST, message)


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], E4Driver]:
    """Share one emitter between all connections, to estimate losses across them."""
    own = own_settings(E4Settings, settings)
    emitter = E4Emitter(sink)
    return lambda: E4Driver(own, sink, emitter)


async def find(configured: Sequence[DeviceSettings]) -> list[Found]:
    """Return the wristbands of the servers in the settings, or of the default server.

    Raises
    ------
    TransportError, ProtocolError
        If a server does not answer.
    """
    servers = {_server(settings) for settings in configured} or {(DEFAULT_HOST, DEFAULT_PORT)}
    found: list[Found] = []
    for host, port in sorted(servers):
        found += [_found(host, port, each) for each in await _wristbands(host, port)]
    return found


def _server(settings: DeviceSettings) -> tuple[str, int]:
    values = settings.model_dump()
    return values["host"], values["port"]


async def _wristbands(host: str, port: int) -> Iterable[Wristband]:
    """Return the wristbands that the server streams or could stream."""
    talk = _Conversation(host, port)
    try:
        await talk.open()
        known = [
            await talk.ask(command, timeout_s=_TIMEOUT_S)
            for command in ("device_list", "device_discover_list")
        ]
    finally:
        await talk.close()
    return {each.device: each for reply in known for each in reply.devices}.values()


def _found(host: str, port: int, wristband: Wristband) -> Found:
    settings: dict[str, str | int | float | bool] = {
        "unit": wristband.device.upper(),
        "device": wristband.device,
    }
    if (host, port) != (DEFAULT_HOST, DEFAULT_PORT):
        settings |= {"host": host, "port": port}
    return Found("empatica_e4", f"E4 {wristband.device}", settings)


DRIVER = DriverEntry(E4Settings, _make, find=find)
