"""One connection to a device: what is asked of it, and where its packets go."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.ble_heart_rate.driver.strap import Strap
from biosensor_gateway.devices.ble_session import BleSession
from biosensor_gateway.devices.movesense.driver import protocol
from biosensor_gateway.devices.movesense.driver.emitter import MovesenseEmitter
from biosensor_gateway.devices.movesense.driver.protocol import (
    COMMAND,
    DATA,
    HELLO_REFERENCE,
    OUT_OF_SLOTS,
    TOO_MANY_REQUESTS,
    Assembler,
    Greeting,
    Kind,
    Measurement,
    Message,
    parse_message,
)
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.transports.ble import BleLink, Notification

ANSWER_LIMIT_S = 5.0
REFUSAL_LIMIT_S = 0.5
RESTART_ADVICE = "restart the device: take it out of its strap for a minute"


class _Conversation(BleSession[Notification, bytes]):
    """What is said over one connection."""

    def __init__(self, link: BleLink) -> None:
        super().__init__(link, self._receive, self._send, RESTART_ADVICE)
        self._answers = True

    async def begin(self) -> Greeting:
        """Listen, and ask the device what it is.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``UNSUPPORTED`` by its firmware, ``NO_REPLY`` or ``REFUSED``.
        """
        if not (self.link.has(COMMAND) and self.link.has(DATA)):
            message = (
                f"{self.link.what} does not speak the GATT SensorData Protocol; update its "
                "firmware to 2.3 or newer with the Movesense app"
            )
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        # Before the first command, whose answer would be lost otherwise.
        await self.link.subscribe(DATA)
        self.dialogue.begin()
        answer = await self._ask(protocol.hello(HELLO_REFERENCE), HELLO_REFERENCE)
        if protocol.is_refused_greeting(answer.payload):
            message = f"{self.link.what} refuses to talk ({answer.status}); {RESTART_ADVICE}"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        greeting = protocol.parse_greeting(answer.payload)
        self._answers = greeting.answers
        return greeting

    async def subscribe(self, measurement: Measurement) -> int:
        """Have the device send a measurement; return the status of a refusal, 0 if there is none.

        Firmware of the first version answers only where it has no room: without an answer it is
        taken at its word, and what does not come is noticed.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``NO_REPLY``.
        """
        command = protocol.subscribe(measurement.reference, measurement.path)
        if self._answers:
            answer = await self._ask(command, measurement.reference)
        else:
            answer = await self.dialogue.ask(
                command, _answer_to(measurement.reference), REFUSAL_LIMIT_S
            )
        return answer.status if answer is not None and answer.is_refusal else 0

    async def unsubscribe(self, measurement: Measurement) -> None:
        """End a measurement without waiting for an answer; raises as :meth:`subscribe` does."""
        await self._send(protocol.unsubscribe(measurement.reference))

    async def _ask(self, command: bytes, reference: int) -> Message:
        return await self.ask(command, _answer_to(reference), ANSWER_LIMIT_S)

    async def _receive(self) -> Sequence[Notification]:
        return (await self.link.next(),)

    async def _send(self, command: bytes) -> None:
        await self.link.write(COMMAND, command)


def _answer_to(reference: int) -> Callable[[Notification], Message | None]:
    def answer(notification: Notification) -> Message | None:
        message = parse_message(notification.data) if notification.uuid == DATA else None
        if message is None or message.reference != reference:
            return None
        # Where data come, the answer to the subscription is lost or on its way.
        return message if message.kind in (Kind.ANSWER, Kind.DATA) else None

    return answer


_ADVICE = {
    TOO_MANY_REQUESTS: RESTART_ADVICE,
    OUT_OF_SLOTS: "it has no room for more measurements; switch one off in the settings",
}
_OTHER_ADVICE = "choose another rate, or switch it off in the settings"


class MovesenseSession:
    """Everything that lasts as long as one link.

    Parameters
    ----------
    sink
        Its ``dropped_bytes`` are counted here.
    wanted
        Measurements to run.

    Attributes
    ----------
    denied
        By data name, why the device does not measure.
    """

    def __init__(
        self, link: BleLink, emitter: MovesenseEmitter, sink: Sink, wanted: Sequence[Measurement]
    ) -> None:
        self.denied: Mapping[str, str] = {}
        self._link = link
        self._emitter = emitter
        self._sink = sink
        self._wanted = {each.reference: each for each in wanted}
        self._assemblers: dict[int, Assembler] = {}
        self._strap = Strap(link, emitter.strap)
        self._conversation = _Conversation(link)

    async def open(self) -> DeviceInfo:
        """Connect, start everything, and return what the device says of itself.

        Raises
        ------
        TransportError, ProtocolError
            The device cannot be used now.
        """
        await self._conversation.connect()
        self._emitter.reconnected()
        greeting = await self._conversation.begin()
        refusals = {each: await self._start(each) for each in self._wanted.values()}
        refusals = {each: status for each, status in refusals.items() if status}
        if refusals and len(refusals) == len(self._wanted):
            (_, status), *_ = refusals.items()
            why = _ADVICE.get(status, _OTHER_ADVICE)
            message = f"{self._link.what} refuses to measure ({status}); {why}"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        self.denied = {
            name: f"{each.path} is refused ({status}): {_ADVICE.get(status, _OTHER_ADVICE)}"
            for each, status in refusals.items()
            for name in each.streams
            if name not in self._emitter.silent
        }
        return _device_info(greeting)

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        """
        await self._conversation.stream(
            self._take, self._emitter.strap.signal_strength, self._strap.watch_battery
        )

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Start anew what is behind silent streams, and what comes too rarely to be missed.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``NO_REPLY``.
        """
        for each in self._wanted.values():
            if each.rate_hz is None or not streams.isdisjoint(each.streams):
                await self._conversation.unsubscribe(each)
                await self._start(each)

    async def close(self) -> None:
        """Stop everything, for a moment, and disconnect; never raises."""
        await self._conversation.close(self._say_goodbye)

    async def _say_goodbye(self) -> None:
        for each in self._wanted.values():
            await self._conversation.unsubscribe(each)
        await self._link.unsubscribe(DATA)

    async def _start(self, measurement: Measurement) -> int:
        """Subscribe; return the status of a refusal, 0 if there is none."""
        self._emitter.started(measurement)
        self._assemblers[measurement.reference] = Assembler(
            measurement.full_bytes, measurement.sample_bytes
        )
        status = await self._conversation.subscribe(measurement)
        if not status:
            self._emitter.granted(measurement)
        return status

    def _take(self, found: Sequence[Notification]) -> None:
        for notification in found:
            if notification.uuid == DATA:
                self._take_message(notification)
            else:
                self._strap.take(notification)

    def _take_message(self, notification: Notification) -> None:
        message = parse_message(notification.data)
        if message is not None and message.kind is Kind.ANSWER:
            self._sink.heard()
            return
        measurement = None if message is None else self._wanted.get(message.reference)
        if message is None or measurement is None:
            self._sink.dropped_bytes += len(notification.data)
            return
        assembler = self._assemblers[message.reference]
        before = assembler.dropped_bytes
        for packet in assembler.take(message, notification.arrival):
            self._emitter.take(measurement, packet)
        self._sink.dropped_bytes += assembler.dropped_bytes - before


def _device_info(greeting: Greeting) -> DeviceInfo:
    firmware = f"{greeting.app} {greeting.app_version}".strip()
    return DeviceInfo("", greeting.product, greeting.serial_number, firmware)
