"""The control point of one connection, and the measurements that it controls."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import structlog

from biosensor_common.errors import GatewayError
from biosensor_gateway.devices.ble_session import BleSession, optional_request
from biosensor_gateway.devices.polar_h10.driver.emitter import PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol import control_point
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    CONTROL_POINT,
    Measurement,
    Reply,
    Setting,
    Status,
    choose,
    has_features,
    parse_features,
    parse_indication,
    parse_settings,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import DATA
from biosensor_gateway.transports.ble import BleLink, Notification

REPLY_TIMEOUT_S = 5.0
_RESTART_ADVICE = "take it off for a minute"


def _unnoted(_reply: Reply) -> None:
    """Do nothing with a reply."""


class ControlPoint(BleSession[Notification, bytes]):
    """The control point of one connection.

    Parameters
    ----------
    receive
        Waits for replies and data from the device.
    """

    def __init__(
        self, link: BleLink, receive: Callable[[], Awaitable[Sequence[Notification]]]
    ) -> None:
        super().__init__(link, receive, self._write, _RESTART_ADVICE)
        self.is_listed = True  # Whether the device said what it offers.
        self._knocking = False
        self._open = False

    @property
    def knocking(self) -> bool:
        """Whether a subscription or command was sent but no command was answered.

        A device that requires pairing may refuse either.
        """
        return self._knocking and not self._open

    async def open(self) -> frozenset[int]:
        """Subscribe to replies and data; return the measurements that the device offers.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        AttError
            If the device refuses, possibly because it requires pairing.
        """
        # Before subscribing, because BlueZ also passes on values read as notifications.
        listed = await self.link.read(CONTROL_POINT)
        if not has_features(listed):
            listed = await self.link.read(CONTROL_POINT)
        self.is_listed = has_features(listed)
        self._knocking = True
        # Before the first command, otherwise it is refused or never answered.
        await self.link.subscribe(CONTROL_POINT)
        await self.link.subscribe(DATA)
        return parse_features(listed)

    async def request(self, command: bytes, note: Callable[[Reply], None] = _unnoted) -> Reply:
        """Send a command and return its complete reply, whatever its status.

        Parameters
        ----------
        note
            Called with the reply before later data are processed.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        AttError
            If the device does not accept the command.
        ProtocolError
            ``NO_REPLY``.
        """
        return await self.ask(command, _ReplyTo(command, note).take, REPLY_TIMEOUT_S)

    async def send(self, command: bytes) -> None:
        """Send a command without waiting for a reply; raises like `open`."""
        await self.link.write(CONTROL_POINT, command)

    async def unsubscribe(self) -> None:
        """Unsubscribe; raises like `open`."""
        await self.link.unsubscribe(DATA)
        await self.link.unsubscribe(CONTROL_POINT)

    async def _write(self, command: bytes) -> None:
        await self.link.write(CONTROL_POINT, command)
        self._open = True


class _ReplyTo:
    """Finds the reply to a command, which may come in several packets."""

    def __init__(self, command: bytes, note: Callable[[Reply], None]) -> None:
        self._asked = command[:2]
        self._note = note
        self._parameters = b""

    def take(self, notification: Notification) -> Reply | None:
        if notification.uuid != CONTROL_POINT:
            return None
        part = parse_indication(notification.data)
        if not isinstance(part, Reply) or bytes([part.operation, part.measurement]) != self._asked:
            return None
        self._parameters += part.parameters
        if part.more:
            return None
        reply = replace(part, parameters=self._parameters)
        self._note(reply)
        return reply


_log = structlog.get_logger("biosensor_gateway.polar_h10")


_ADVICE: Mapping[int, str] = {
    Status.INVALID_MTU: "its packets are too large for this Bluetooth adapter; use another one",
    Status.DEVICE_IN_CHARGER: "take it out of its charger",
}


@dataclass(frozen=True, slots=True)
class Wanted:
    """A measurement to run."""

    measurement: Measurement
    # Preferred value of each setting, at least the sample rate; empty for a measurement without
    # settings.
    settings: Mapping[Setting, int] = field(default_factory=dict[Setting, int])
    # Real sample rates by those that the firmware reports.
    true_rates: Mapping[int, int] = field(default_factory=dict[int, int])


@dataclass(slots=True)
class _Running:
    wanted: Wanted
    settings: Mapping[Setting, int]

    @property
    def rate_hz(self) -> int | None:
        """The sample rate; None for irregular samples."""
        asked = self.wanted.settings.get(Setting.SAMPLE_RATE)
        said = self.settings.get(Setting.SAMPLE_RATE, asked)
        return None if said is None else self.wanted.true_rates.get(said, said)


@dataclass(frozen=True, slots=True)
class Refusal:
    """A measurement that the device refuses to start."""

    wanted: Wanted
    why: str  # Its answer and what to do; a clause.
    rate_hz: int | None  # Rate that it would have; None for irregular samples.


class Measurements:
    """The measurements of one connection."""

    def __init__(self, control: ControlPoint, emitter: PolarEmitter) -> None:
        self._control = control
        self._emitter = emitter
        self.refusals: dict[Measurement, Refusal] = {}  # Requested measurements that were refused.
        self._running: dict[int, _Running] = {}

    async def start(self, wanted: Sequence[Wanted]) -> None:
        """Start the available measurements, and note refusals.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``NO_REPLY``.
        """
        for each in wanted:
            await self._start(each)

    async def ask_again(self) -> None:
        """Retry refused measurements.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        with optional_request(_log.warning):
            await self.start([each.wanted for each in self.refusals.values()])

    def runs(self, measurement: int) -> bool:
        """Whether a measurement was started on this connection."""
        return measurement in self._running

    async def restart(self, measurements: Collection[int]) -> None:
        """Stop and start measurements that send nothing.

        If all regular ones are silent, the irregular ones are restarted, too, because the device
        may have forgotten them unnoticed.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        regular = {key for key, each in self._running.items() if each.rate_hz is not None}
        forgot_all = bool(regular) and regular <= set(measurements)
        for measurement, each in list(self._running.items()):
            if forgot_all or measurement in measurements:
                await self._restart(each)

    async def stop(self) -> None:
        """Stop all measurements without waiting for replies; never raises."""
        for each in list(self._running.values()):
            with suppress(GatewayError):
                await self._control.send(control_point.stop(each.wanted.measurement))

    async def _start(self, wanted: Wanted) -> None:
        each = _Running(wanted, {})
        if wanted.settings:
            reply = await self._control.request(control_point.get_settings(wanted.measurement))
            if reply.status != Status.SUCCESS:
                self._note_refused(each, reply)
                return
            each.settings = choose(parse_settings(reply.parameters), wanted.settings)
        reply = await self._set_going(each)
        if reply.status != Status.SUCCESS:
            self._note_refused(each, reply)

    async def _restart(self, each: _Running) -> None:
        with optional_request(_log.warning):
            await self._control.request(control_point.stop(each.wanted.measurement))
            await self._set_going(each)

    async def _set_going(self, each: _Running) -> Reply:
        measurement = each.wanted.measurement
        command = control_point.start(measurement, each.settings)

        def note(reply: Reply) -> None:
            if reply.status == Status.SUCCESS:
                self._note_started(each, reply)

        reply = await self._control.request(command, note)
        if reply.status == Status.ALREADY_IN_STATE:
            # A previous host left it running with different settings.
            await self._control.request(control_point.stop(measurement))
            reply = await self._control.request(command, note)
        return reply

    def _note_started(self, each: _Running, reply: Reply) -> None:
        (factor,) = parse_settings(reply.parameters).get(Setting.FACTOR, (1.0,))[:1] or (1.0,)
        self._emitter.started(each.wanted.measurement, each.rate_hz, factor)
        self._running[each.wanted.measurement] = each
        if self.refusals.pop(each.wanted.measurement, None) is not None and each.rate_hz is None:
            self._emitter.agreed(each.wanted.measurement)

    def _note_refused(self, each: _Running, reply: Reply) -> None:
        advice = _ADVICE.get(reply.status, _RESTART_ADVICE)
        why = f"{reply.status_text}: {advice}"
        self.refusals[each.wanted.measurement] = Refusal(each.wanted, why, each.rate_hz)
