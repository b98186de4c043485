"""Which measurements run, from their start to their end."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import structlog

from biosensor_common.errors import (
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.polar_h10.control import ControlPoint
from biosensor_gateway.devices.polar_h10.emitter import PolarEmitter
from biosensor_gateway.devices.polar_h10.protocol import control_point
from biosensor_gateway.devices.polar_h10.protocol.control_point import (
    Measurement,
    Reply,
    Setting,
    Status,
    choose,
    parse_settings,
)

RESTART_AFTER_S = 5.0
GIVE_UP_AFTER_S = 15.0

_log = structlog.get_logger("biosensor_gateway.polar_h10")


@dataclass(frozen=True, slots=True)
class Wanted:
    """A measurement to run.

    Attributes
    ----------
    measurement
    settings
        Preferred value of each setting, the sample rate at least; empty for a
        measurement without settings.
    """

    measurement: Measurement
    settings: Mapping[Setting, int] = field(default_factory=dict[Setting, int])


@dataclass(slots=True)
class _Running:
    wanted: Wanted
    settings: Mapping[Setting, int]
    heard_s: float
    tried_s: float

    @property
    def is_regular(self) -> bool:
        """Whether its frames come all the time, and not when something happens."""
        return bool(self.wanted.settings)


class Measurements:
    """The measurements of one connection.

    Parameters
    ----------
    what
        The device's name for messages.
    control
    emitter
    """

    def __init__(self, what: str, control: ControlPoint, emitter: PolarEmitter) -> None:
        self._what = what
        self._control = control
        self._emitter = emitter
        self._running: dict[int, _Running] = {}

    async def start(self, wanted: Sequence[Wanted]) -> None:
        """Start measurements that the device offers.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``REFUSED``: the device refuses all of them; ``NO_REPLY``.
        """
        refusals = [refusal for each in wanted if (refusal := await self._start(each))]
        if not refusals:
            return
        message = f"{self._what}: the device refuses to measure ({'; '.join(refusals)})"
        if not self._running:
            raise ProtocolError(ProtocolReason.REFUSED, f"{message}; take it off for a minute")
        _log.warning(message)

    def heard(self, measurement: int | None) -> bool:
        """Note that a frame arrived; return whether it is of a measurement that we started."""
        running = self._running.get(measurement) if measurement is not None else None
        if running is not None:
            running.heard_s = time.monotonic()
        return running is not None

    async def restart_silent(self) -> None:
        """Stop and start measurements from which nothing comes; to be called all the time.

        Raises
        ------
        TransportError
            ``SILENT``, when that has not helped; ``LOST``.
        """
        now = time.monotonic()
        for each in [each for each in self._running.values() if each.is_regular]:
            if now - each.heard_s >= GIVE_UP_AFTER_S:
                message = f"{self._what}: connected, but no data for {GIVE_UP_AFTER_S:.0f} s"
                raise TransportError(TransportReason.SILENT, f"{message}; connecting anew")
            if now - max(each.heard_s, each.tried_s) >= RESTART_AFTER_S:
                each.tried_s = now
                await self._restart(each)

    async def stop(self) -> None:
        """Stop all measurements without waiting for replies; never raises."""
        for each in list(self._running.values()):
            with suppress(GatewayError):
                await self._control.send(control_point.stop(each.wanted.measurement))

    async def _start(self, wanted: Wanted) -> str:
        """Start one; return why the device refuses, empty if it does not."""
        settings: Mapping[Setting, int] = {}
        if wanted.settings:
            reply = await self._control.request(control_point.get_settings(wanted.measurement))
            if reply.status != Status.SUCCESS:
                return _refusal(wanted, reply)
            settings = choose(parse_settings(reply.parameters), wanted.settings)
        now = time.monotonic()
        started = _Running(wanted, settings, heard_s=now, tried_s=now)
        reply = await self._set_going(started)
        if reply.status != Status.SUCCESS:
            return _refusal(wanted, reply)
        self._running[wanted.measurement] = started
        return ""

    async def _restart(self, each: _Running) -> None:
        name = each.wanted.measurement.name.lower()
        _log.warning("no data; the measurement is started anew", device=self._what, name=name)
        try:
            await self._control.request(control_point.stop(each.wanted.measurement))
            await self._set_going(each)
        except ProtocolError as error:
            _log.warning(str(error))
        except TransportError as error:
            if error.reason is not TransportReason.SILENT:
                raise

    async def _set_going(self, each: _Running) -> Reply:
        measurement = each.wanted.measurement
        command = control_point.start(measurement, each.settings)
        reply = await self._control.request(command)
        if reply.status == Status.ALREADY_IN_STATE:
            # A host that died left it running, with settings of its own.
            await self._control.request(control_point.stop(measurement))
            reply = await self._control.request(command)
        if reply.status == Status.SUCCESS:
            (factor,) = parse_settings(reply.parameters).get(Setting.FACTOR, (1.0,))[:1] or (1.0,)
            rate = each.settings.get(
                Setting.SAMPLE_RATE, each.wanted.settings.get(Setting.SAMPLE_RATE)
            )
            self._emitter.started(measurement, rate, factor)
        return reply


def _refusal(wanted: Wanted, reply: Reply) -> str:
    return f"{wanted.measurement.name.lower()}: {reply.status_text}"
