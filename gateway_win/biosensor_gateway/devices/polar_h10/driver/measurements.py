"""Starts, restarts and stops measurements, and knows which run."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
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
from biosensor_gateway.devices.polar_h10.driver.control import ControlPoint
from biosensor_gateway.devices.polar_h10.driver.emitter import PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol import control_point
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    Measurement,
    Reply,
    Setting,
    Status,
    choose,
    parse_settings,
)

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

    def runs(self, measurement: int) -> bool:
        """Whether a measurement is one that we started."""
        return measurement in self._running

    async def restart(self, measurements: Collection[int]) -> None:
        """Stop measurements from which nothing comes, and start them.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        for measurement, each in list(self._running.items()):
            if measurement in measurements:
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
        reply = await self._set_going(_Running(wanted, settings))
        return "" if reply.status == Status.SUCCESS else _refusal(wanted, reply)

    async def _restart(self, each: _Running) -> None:
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

        def note(reply: Reply) -> None:
            if reply.status == Status.SUCCESS:
                self._note_started(each, reply)

        reply = await self._control.request(command, note)
        if reply.status == Status.ALREADY_IN_STATE:
            # A host that died left it running, with settings of its own.
            await self._control.request(control_point.stop(measurement))
            reply = await self._control.request(command, note)
        return reply

    def _note_started(self, each: _Running, reply: Reply) -> None:
        (factor,) = parse_settings(reply.parameters).get(Setting.FACTOR, (1.0,))[:1] or (1.0,)
        rate = each.settings.get(Setting.SAMPLE_RATE, each.wanted.settings.get(Setting.SAMPLE_RATE))
        self._emitter.started(each.wanted.measurement, rate, factor)
        self._running[each.wanted.measurement] = each


def _refusal(wanted: Wanted, reply: Reply) -> str:
    return f"{wanted.measurement.name.lower()}: {reply.status_text}"
