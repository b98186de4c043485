"""One connection to a Polar sensor: what is asked of it, and where its answers go."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass

import structlog

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.ble_heart_rate.driver.protocol import HEART_RATE_MEASUREMENT
from biosensor_gateway.devices.ble_heart_rate.driver.strap import DUE, Strap
from biosensor_gateway.devices.polar_h10.driver.control import ControlPoint, Measurements, Wanted
from biosensor_gateway.devices.polar_h10.driver.emitter import PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    CONTROL_POINT,
    Stopped,
    parse_indication,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import DATA
from biosensor_gateway.transports.ble import BleLink, Notification

ASK_AGAIN_FIRST_S = 1.0
ASK_AGAIN_CAP_S = 30.0
"""What the device refuses is asked for again, less and less often."""

_log = structlog.get_logger("biosensor_gateway.polar_h10")


async def _as_it_is(_control: ControlPoint, _offered: frozenset[int]) -> None:
    """Take the device in the mode that it is in."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is asked of a device at each connection.

    Attributes
    ----------
    wanted
        Measurements to run if the device offers them, given what it says of itself.
    prepare
        Called before they are started, with what the device offers.
    farewell
        Commands at the end, when the measurements are stopped.
    has_heart_rate
        Whether its heart rate comes in this mode.
    """

    wanted: Callable[[DeviceInfo], Sequence[Wanted]]
    prepare: Callable[[ControlPoint, frozenset[int]], Awaitable[None]] = _as_it_is
    farewell: Sequence[bytes] = ()
    has_heart_rate: bool = True


class PolarSession:
    """Everything that lasts as long as one link."""

    def __init__(self, link: BleLink, emitter: PolarEmitter, plan: Plan) -> None:
        self._link = link
        self._emitter = emitter
        self._plan = plan
        self._strap = Strap(link, emitter.strap)
        self._control = ControlPoint(link, self._receive)
        self._measurements = Measurements(self._control, emitter)

    async def open(self, *, pair: bool = False) -> DeviceInfo:
        """Connect, start everything, and return what the device says of itself.

        Parameters
        ----------
        pair
            Pair as soon as the link stands.

        Raises
        ------
        TransportError, ProtocolError
            The device cannot be used now.
        """
        await self._control.connect()
        self._control.dialogue.begin()
        if pair:
            await self._link.pair()
        self._emitter.reconnected()
        info = await self._strap.start()
        if self._link.has(CONTROL_POINT):
            await self._start_measurements(info)
        elif self._link.has(HEART_RATE_MEASUREMENT):
            self._emitter.log.warn_once(
                "heart rate and intervals only: the firmware has no PMD service; "
                "update it with Polar Flow",
                firmware=info.firmware_version,
            )
        else:
            message = f"{self._link.what} is no heart-rate sensor; choose another `device`"
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        return info

    @property
    def is_unanswered(self) -> bool:
        """Whether it subscribed to the control point or sent a command, and none came through."""
        return self._control.knocking

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        """
        await self._control.stream(
            self._take,
            self._emitter.strap.signal_strength,
            self._strap.watch_battery,
            self._ask_again,
        )

    @property
    def running(self) -> frozenset[str]:
        """Data names of the measurements that were started."""
        names = self._emitter.data_names
        return frozenset(name for each, name in names.items() if self._measurements.runs(each))

    @property
    def denied(self) -> Mapping[str, str]:
        """By data name, why the device refuses to measure."""
        refusals = self._measurements.refusals
        names = self._emitter.data_names
        return {names[each]: refusal.why for each, refusal in refusals.items()}

    @property
    def rates(self) -> Mapping[str, float]:
        """Nominal rates in Hz by data name, of what runs and of what was refused."""
        refused = {
            self._emitter.data_names[each]: refusal.rate_hz
            for each, refusal in self._measurements.refusals.items()
            if refusal.rate_hz is not None
        }
        return refused | dict(self._emitter.rates)

    @property
    def due(self) -> Mapping[str, float]:
        """Longest absences of what comes all the time without a rate."""
        has_it = self._plan.has_heart_rate and self._link.has(HEART_RATE_MEASUREMENT)
        return DUE if has_it else {}

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Start again what is behind streams that are silent.

        Raises
        ------
        TransportError
            ``LOST``, or ``SILENT`` of the heart rate.
        AttError
            The device refuses to send its heart rate.
        """
        names = {name: measurement for measurement, name in self._emitter.data_names.items()}
        silent = {names[each] for each in streams & names.keys()}
        await self._measurements.restart(silent)
        if not streams <= names.keys():
            await self._strap.subscribe_again()

    async def close(self) -> None:
        """Stop everything, for a moment, and disconnect; never raises.

        A device that is left measuring does so until its battery is flat.
        """
        await self._control.close(self._say_goodbye)

    async def _say_goodbye(self) -> None:
        await self._measurements.stop()
        for command in self._plan.farewell:
            await self._control.send(command)
        await self._strap.stop()
        await self._control.unsubscribe()

    async def _start_measurements(self, info: DeviceInfo) -> None:
        offered = await self._control.open()
        await self._plan.prepare(self._control, offered)
        wanted = self._plan.wanted(info)
        missing = [each.measurement for each in wanted if each.measurement not in offered]
        if missing:
            names = [measurement.name.lower() for measurement in missing]
            self._emitter.log.warn_once(
                "the device cannot measure all that is wanted", missing=names
            )
        await self._measurements.start([each for each in wanted if each.measurement in offered])

    async def _ask_again(self) -> None:
        promised, delay_s = self.rates, ASK_AGAIN_FIRST_S
        while self._measurements.refusals:
            await asyncio.sleep(delay_s)
            await self._measurements.ask_again()
            delay_s = min(2 * delay_s, ASK_AGAIN_CAP_S)
            if self.rates != promised:
                # The streams have been declared with other rates.
                message = (
                    f"{self._link.what}: it measures now, and is connected again for its rates"
                )
                raise TransportError(TransportReason.LOST, message)

    async def _receive(self) -> Sequence[Notification]:
        notification = await self._link.next()
        # Now, not when it is emitted: the measurement may be started again meanwhile.
        is_foreign = notification.uuid == DATA and self._emitter.is_foreign(notification.data)
        return () if is_foreign else (notification,)

    def _take(self, found: Sequence[Notification]) -> None:
        for notification in found:
            if notification.uuid == DATA:
                self._emitter.frame(notification.data, notification.arrival)
            elif notification.uuid != CONTROL_POINT:
                self._strap.take(notification)
            elif isinstance(stopped := parse_indication(notification.data), Stopped):
                # If it is not for good, the watchdog gets it going again.
                _log.warning("the device stopped measuring", device=self._link.what,
                             measurements=stopped.measurements)  # fmt: skip
