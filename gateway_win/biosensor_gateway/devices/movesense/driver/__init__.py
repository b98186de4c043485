"""Driver for Movesense sensors, and its settings."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.ble_heart_rate.driver import Strap
from biosensor_gateway.devices.ble_session import BleSession
from biosensor_gateway.devices.driver import Connected, DriverEntry, by_advertisement, own_settings
from biosensor_gateway.devices.movesense.driver import protocol
from biosensor_gateway.devices.movesense.driver.emitter import MovesenseEmitter
from biosensor_gateway.devices.movesense.driver.protocol import (
    COMMAND,
    DATA,
    HEART_RATE,
    HELLO_REFERENCE,
    MOVEMENT,
    OUT_OF_SLOTS,
    TEMPERATURE,
    TOO_MANY_REQUESTS,
    Assembler,
    Greeting,
    Kind,
    Measurement,
    Message,
    ecg,
    movement,
    parse_message,
)
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import Pairing
from biosensor_gateway.transports.nearby import Advertisement

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_REGULAR = frozenset({"ecg", *MOVEMENT})
KIND = "Movesense"
ADVICE = (
    "snap it into its strap and put that on with wet electrodes, and disconnect it from phones "
    "and other programs"
)
ANSWER_LIMIT_S = 5.0
REFUSAL_LIMIT_S = 0.5
RESTART_ADVICE = "restart the device: take it out of its strap for a minute"


class MovesenseSettings(DeviceSettings):
    """Settings of one Movesense sensor."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the sensor, as scan shows it, or the serial number "
        "engraved on it; if empty, the only one in range.",
        examples=["174630000192"],
    )
    ecg: bool = Field(default=True, description="Whether the sensor sends its ECG.")
    ecg_rate_hz: Literal[125, 128, 200, 250, 256, 500, 512] = Field(
        default=200, description="Samples of ECG per second."
    )
    ecg_in_millivolts: bool = Field(
        default=False,
        description="Let the sensor itself convert the ECG: half the bytes over the air, in steps "
        "of 1 microvolt and up to 32 mV; needs firmware 2.3. Otherwise it sends counts of "
        "0.38 microvolts, which are converted here.",
    )
    acc: bool = Field(default=True, description="Whether the sensor sends its acceleration.")
    gyro: bool = Field(default=True, description="Whether the sensor sends its rate of rotation.")
    mag: bool = Field(default=False, description="Whether the sensor sends the magnetic field.")
    imu_rate_hz: Literal[13, 26, 52, 104, 208] = Field(
        default=52,
        description="Samples per second of acceleration, rotation and magnetic field, which are "
        "measured together. All three at 208 may be more than a connection carries.",
    )
    pair: bool = Field(
        default=False,
        description="Pair before connecting, for a sensor that is set to require it; it remembers "
        "one computer or phone at a time.",
    )

    @property
    def wanted(self) -> frozenset[str]:
        """Data names of the regular streams that are switched on."""
        switches = {"ecg": self.ecg, "acc": self.acc, "gyro": self.gyro, "mag": self.mag}
        return frozenset(name for name, is_on in switches.items() if is_on)


class _Conversation(BleSession[Notification, bytes]):
    """The commands and answers on one connection."""

    def __init__(self, link: BleLink) -> None:
        super().__init__(link, self._receive, self._send, RESTART_ADVICE)
        self._answers = True

    async def begin(self) -> Greeting:
        """Subscribe, and query the device information.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``UNSUPPORTED`` firmware, ``NO_REPLY`` or ``REFUSED``.
        """
        if not (self.link.has(COMMAND) and self.link.has(DATA)):
            message = (
                f"{self.link.what} does not support the GATT SensorData Protocol; update its "
                "firmware to 2.3 or newer with the Movesense app"
            )
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        # Before the first command, otherwise its answer would be lost.
        await self.link.subscribe(DATA)
        self.dialogue.begin()
        answer = await self._ask(protocol.hello(HELLO_REFERENCE), HELLO_REFERENCE)
        if protocol.is_refused_greeting(answer.payload):
            message = f"{self.link.what} refuses to communicate ({answer.status}); {RESTART_ADVICE}"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        greeting = protocol.parse_greeting(answer.payload)
        self._answers = greeting.answers
        return greeting

    async def subscribe(self, measurement: Measurement) -> int:
        """Subscribe to a measurement; return the status of a refusal, 0 if there is none.

        First-version firmware only answers if it has no free slot. A missing answer counts as
        success, and the watchdog detects streams without data.

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
        """End a measurement without waiting for an answer; raises like :meth:`subscribe`."""
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
        # If data arrive, the answer to the subscription was lost or is delayed.
        return message if message.kind in (Kind.ANSWER, Kind.DATA) else None

    return answer


_ADVICE = {
    TOO_MANY_REQUESTS: RESTART_ADVICE,
    OUT_OF_SLOTS: "it has no room for more measurements; switch one off in the settings",
}
_OTHER_ADVICE = "choose another rate, or switch it off in the settings"


class MovesenseDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`.

    Parameters
    ----------
    sink
        Its ``dropped_bytes`` are increased here.
    rates
        Nominal rates of regular streams by data name.
    """

    # With ECG and movement off, there may only be the temperature.
    silence_limit_s = 60.0

    def __init__(
        self,
        link: BleLink,
        emitter: MovesenseEmitter,
        sink: DeviceSink,
        wanted: Sequence[Measurement],
        rates: Mapping[str, float],
    ) -> None:
        self._link = link
        self._emitter = emitter
        self._sink = sink
        self._rates = rates
        self._wanted = {each.reference: each for each in wanted}
        self._assemblers: dict[int, Assembler] = {}
        self._strap = Strap(link, emitter.strap)
        self._conversation = _Conversation(link)

    async def connect(self) -> Connected:
        """Connect and start all measurements; see the protocol class."""
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
        denied = {
            name: f"{each.path} is refused ({status}): {_ADVICE.get(status, _OTHER_ADVICE)}"
            for each, status in refusals.items()
            for name in each.streams
            if name not in self._emitter.silent
        }
        denied |= await self._strap.ask_for_battery()
        return Connected(
            _device_info(greeting), self._rates, frozenset(self._emitter.silent), denied=denied
        )

    async def stream(self) -> None:
        """Emit data received since connecting; see the protocol class."""
        await self._conversation.stream(
            self._take, self._emitter.strap.signal_strength, self._strap.watch_battery
        )

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Restart the measurements of silent streams, and those too rare for monitoring."""
        for each in self._wanted.values():
            if each.rate_hz is None or not streams.isdisjoint(each.streams):
                await self._conversation.unsubscribe(each)
                await self._start(each)

    async def close(self) -> None:
        """Stop all measurements, without waiting for answers, and disconnect."""
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


def _measurements(settings: MovesenseSettings) -> Sequence[Measurement]:
    found = [HEART_RATE, TEMPERATURE]
    moving = settings.wanted & frozenset(MOVEMENT)
    if moving:
        found.insert(0, movement(moving, settings.imu_rate_hz))
    if settings.ecg:
        found.insert(0, ecg(settings.ecg_rate_hz, in_millivolts=settings.ecg_in_millivolts))
    return found


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], MovesenseDriver]:
    """Share the emitter and the device selection between all connections."""
    own = own_settings(MovesenseSettings, settings)
    silent = _REGULAR - own.wanted
    emitter = MovesenseEmitter(sink, silent)
    choice = Choice(identify, KIND, own.device, ADVICE)
    measurements = _measurements(own)
    rates = {"ecg": float(own.ecg_rate_hz)}
    pairing = Pairing("yes" if own.pair else "no")
    rates |= dict.fromkeys(MOVEMENT, float(own.imu_rate_hz))

    def make() -> MovesenseDriver:
        link = BleLink(choice, sink.clock, pairing=pairing)
        return MovesenseDriver(link, emitter, sink, measurements, rates)

    return make


def identify(seen: Advertisement) -> str | None:
    """Return the serial number from the name ``Movesense <serial>``; None for other devices."""
    kind, _, serial = seen.name.strip().partition(" ")
    return serial.strip() if kind == KIND else None


recognise = by_advertisement("movesense", identify)
# The address is the third text of the greeting.
IDENTIFIERS = (re.compile(rb"\0([0-9A-Fa-f:-]{12,17})\0"),)
DRIVER = DriverEntry(MovesenseSettings, _make, recognise=recognise, identifiers=IDENTIFIERS)
