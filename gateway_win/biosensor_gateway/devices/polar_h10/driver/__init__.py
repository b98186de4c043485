"""Driver for the Polar H10, and its parts for other devices with the PMD service."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import structlog
from pydantic import Field

from biosensor_common.errors import (
    CredentialError,
    CredentialReason,
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.ble_heart_rate.driver import DUE, Strap
from biosensor_gateway.devices.ble_heart_rate.driver.protocol import (
    HEART_RATE_MEASUREMENT,
    HEART_RATE_SERVICE,
)
from biosensor_gateway.devices.driver import Connected, DriverEntry, by_advertisement, own_settings
from biosensor_gateway.devices.polar_h10.driver.control import ControlPoint, Measurements, Wanted
from biosensor_gateway.devices.polar_h10.driver.emitter import DATA_NAMES, PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    CONTROL_POINT,
    Measurement,
    Setting,
    Stopped,
    parse_indication,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import DATA
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import PAIR_DESCRIPTION, Pairing, PairSetting
from biosensor_gateway.transports.nearby import Advertisement

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

ASK_AGAIN_FIRST_S = 1.0
ASK_AGAIN_CAP_S = 30.0
"""Longest interval of retries, with increasing delay, for what the device refuses."""

_log = structlog.get_logger("biosensor_gateway.polar_h10")


async def _as_it_is(_control: ControlPoint, _offered: frozenset[int]) -> None:
    """Leave the device in its current mode."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What to start on a device at each connection."""

    # Returns the measurements to run, given the device information; unavailable ones are skipped.
    wanted: Callable[[DeviceInfo], Sequence[Wanted]]
    # Called before the start with the measurements that the device offers.
    prepare: Callable[[ControlPoint, frozenset[int]], Awaitable[None]] = _as_it_is
    farewell: Sequence[bytes] = ()  # Commands to send at the end, after stopping the measurements.
    has_heart_rate: bool = True  # Whether the device sends its heart rate in this mode.


class PolarSession:
    """One connection to a device with a PMD service."""

    def __init__(self, link: BleLink, emitter: PolarEmitter, plan: Plan) -> None:
        self._link = link
        self._emitter = emitter
        self._plan = plan
        self._strap = Strap(link, emitter.strap)
        self._control = ControlPoint(link, self._receive)
        self._measurements = Measurements(self._control, emitter)
        self._denied: dict[str, str] = {}

    async def open(self, *, pair: bool = False) -> DeviceInfo:
        """Connect, start everything, and return the device information.

        Parameters
        ----------
        pair
            Pair as soon as the link is established.

        Raises
        ------
        TransportError, ProtocolError
            If the device cannot be used now.
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
            message = f"{self._link.what} is not a heart-rate sensor; choose another `device`"
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        self._denied |= await self._strap.ask_for_battery()
        return info

    @property
    def is_unanswered(self) -> bool:
        """Whether a subscription or command was sent but none has been answered."""
        return self._control.knocking

    async def stream(self) -> None:
        """Emit data received since connecting.

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
        """Why the device refuses to measure, by data name."""
        refusals = self._measurements.refusals
        names = self._emitter.data_names
        measured = {names[each]: refusal.why for each, refusal in refusals.items()}
        return measured | self._denied

    @property
    def rates(self) -> Mapping[str, float]:
        """Nominal rates in Hz of running and refused measurements, by data name."""
        refused = {
            self._emitter.data_names[each]: refusal.rate_hz
            for each, refusal in self._measurements.refusals.items()
            if refusal.rate_hz is not None
        }
        return refused | dict(self._emitter.rates)

    @property
    def due(self) -> Mapping[str, float]:
        """Maximum gaps of irregular streams that are sent continuously."""
        has_it = self._plan.has_heart_rate and self._link.has(HEART_RATE_MEASUREMENT)
        return DUE if has_it else {}

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Restart the measurements of silent streams.

        Raises
        ------
        TransportError
            ``LOST``, or ``SILENT`` for the heart rate.
        AttError
            If the device refuses to send its heart rate.
        """
        names = {name: measurement for measurement, name in self._emitter.data_names.items()}
        silent = {names[each] for each in streams & names.keys()}
        await self._measurements.restart(silent)
        if not streams <= names.keys():
            await self._strap.subscribe_again()

    async def close(self) -> None:
        """Try to stop everything within a short time, and disconnect; never raises.

        Otherwise the device would measure until its battery is empty.
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
        if missing and not self._control.is_listed:
            why = "it does not say what it can measure; switch it off and on"
            self._denied = {self._emitter.data_names[each]: why for each in missing}
        elif missing:
            names = [measurement.name.lower() for measurement in missing]
            self._emitter.log.warn_once(
                "the device cannot measure everything requested", missing=names
            )
        await self._measurements.start([each for each in wanted if each.measurement in offered])

    async def _ask_again(self) -> None:
        promised, delay_s = self.rates, ASK_AGAIN_FIRST_S
        while self._measurements.refusals:
            await asyncio.sleep(delay_s)
            await self._measurements.ask_again()
            delay_s = min(2 * delay_s, ASK_AGAIN_CAP_S)
            if self.rates != promised:
                # The streams were declared with different rates.
                message = (
                    f"{self._link.what}: it measures now, and is connected again for its rates"
                )
                raise TransportError(TransportReason.LOST, message)

    async def _receive(self) -> Sequence[Notification]:
        notification = await self._link.next()
        # Checked on arrival, because the measurement may be restarted before the data are emitted.
        is_foreign = notification.uuid == DATA and self._emitter.is_foreign(notification.data)
        return () if is_foreign else (notification,)

    def _take(self, found: Sequence[Notification]) -> None:
        for notification in found:
            if notification.uuid == DATA:
                self._emitter.frame(notification.data, notification.arrival)
            elif notification.uuid != CONTROL_POINT:
                self._strap.take(notification)
            elif isinstance(stopped := parse_indication(notification.data), Stopped):
                # If this is temporary, the watchdog restarts it.
                _log.warning("the device stopped measuring", device=self._link.what,
                             measurements=stopped.measurements)  # fmt: skip


ECG_RATE_HZ = 130
PATIENCE_S = 5.0
FULL_FRAME = 110
"""Maximum number of compressed three-axis samples in a frame with the MTU of Polar devices."""
_ADVICE = "put it on with wet electrodes, and close the apps that use it"

MANUFACTURER_ID = 0x006B
_MODELS = frozenset({"H10"})


class PolarH10Settings(DeviceSettings):
    """Settings of one H10."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the strap, as scan shows it, or the id printed on it (8 "
        "characters); if empty, the only one in range.",
        examples=["A1B2C3D4"],
    )
    ecg: bool = Field(default=True, description="Whether the strap sends its ECG.")
    acc: bool = Field(default=True, description="Whether the strap sends its acceleration.")
    acc_rate_hz: Literal[25, 50, 100, 200] = Field(
        default=50,
        description="Samples of acceleration per second. More than 50 together with the ECG is too "
        "much for some Bluetooth adapters.",
    )
    acc_range_g: Literal[2, 4, 8] = Field(
        default=8, description="Largest acceleration that can be measured, in g."
    )
    pair: PairSetting = Field(default="auto", description=PAIR_DESCRIPTION)


class PolarDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`.

    Parameters
    ----------
    meet
        Creates the session; called again if the device requires pairing.
    silent
        Data names of streams that the settings switch off.
    fallback_rates
        Rates in Hz, by data name, for the headers of streams that the device may not have.
    """

    # The heart rate is sent every second, or every 5 s by an optical sensor that measures
    # intervals.
    silence_limit_s = 15.0

    def __init__(
        self,
        meet: Callable[[], PolarSession],
        pairing: Pairing,
        emitter: PolarEmitter,
        silent: frozenset[str],
        fallback_rates: Mapping[str, float] | None = None,
    ) -> None:
        self._meet = meet
        self._pairing = pairing
        self._silent = silent
        self._fallback_rates = fallback_rates or {}
        self._session = meet()
        self._emitter = emitter

    async def connect(self) -> Connected:
        """Connect and start all measurements; see the protocol class."""
        try:
            info = await self._session.open()
        except GatewayError as error:
            if not self._helps(error):
                raise
            _log.info("pairing, because the device does not answer unpaired", cause=str(error))
        else:
            return self._connected(info)
        # The attempt may have broken the connection, and BlueZ may have tried to pair by itself.
        await self._session.close()
        self._pairing.note_demand()
        self._session = self._meet()
        try:
            info = await self._session.open(pair=not self._pairing.comes_first)
        except GatewayError as error:
            raise _pairing_failure(error, still_demands=self._helps(error)) from error
        return self._connected(info)

    async def stream(self) -> None:
        """Emit data received since connecting; see the protocol class."""
        await self._session.stream()

    async def close(self) -> None:
        """Stop all measurements, without waiting for the replies, and disconnect."""
        await self._session.close()

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Restart silent measurements, and subscribe to the heart rate again."""
        await self._session.enable_again(streams)

    def _helps(self, error: GatewayError) -> bool:
        return self._pairing.helps(error, is_unanswered=self._session.is_unanswered)

    def _connected(self, info: DeviceInfo) -> Connected:
        denied = self._session.denied
        names = frozenset(self._emitter.data_names.values())
        refused = names - self._session.running - denied.keys()
        rates = self._session.rates
        # The frames of slow measurements take long to fill.
        patience_s = max([PATIENCE_S, *(2 * FULL_FRAME / rate for rate in rates.values())])
        return Connected(
            info,
            {**self._fallback_rates, **rates},
            self._silent,
            refused=refused,
            denied=denied,
            due=self._session.due,
            patience_s=patience_s,
        )


def _pairing_failure(error: GatewayError, *, still_demands: bool) -> GatewayError:
    """Return the error to raise when even a paired connection fails."""
    denied = isinstance(error, TransportError) and error.reason is TransportReason.DENIED
    if not denied and not still_demands:
        return error
    message = (
        f"{error}; pairing does not help: remove the sensor in the system's Bluetooth settings, "
        "then start again"
    )
    if isinstance(error, TransportError) and not denied:
        return ProtocolError(ProtocolReason.NO_REPLY, message)
    return CredentialError(CredentialReason.REJECTED, message)


def _wanted(settings: PolarH10Settings) -> Sequence[Wanted]:
    ecg = Wanted(Measurement.ECG, {Setting.SAMPLE_RATE: ECG_RATE_HZ})
    acceleration = Wanted(
        Measurement.ACCELERATION,
        {Setting.SAMPLE_RATE: settings.acc_rate_hz, Setting.RANGE: settings.acc_range_g},
    )
    return [*([ecg] if settings.ecg else []), *([acceleration] if settings.acc else [])]


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], PolarDriver]:
    """Share the emitter and the device selection between all connections."""
    own = own_settings(PolarH10Settings, settings)
    emitter = PolarEmitter(sink)
    choice = Choice(identify, "Polar H10", own.device, _ADVICE)
    wanted = _wanted(own)
    plan = Plan(lambda _: wanted)
    silent = frozenset(DATA_NAMES.values()) - {DATA_NAMES[each.measurement] for each in wanted}

    pairing = Pairing(own.pair)

    def meet() -> PolarSession:
        return PolarSession(BleLink(choice, sink.clock, pairing=pairing), emitter, plan)

    return lambda: PolarDriver(meet, pairing, emitter, silent)


def identify(seen: Advertisement, models: Collection[str] = _MODELS) -> str | None:
    """Return the id printed on a sensor of these models; None for other devices.

    It is part of the name ``Polar <model> <id>``, which is only in the scan response.
    """
    words = seen.name.split()
    if len(words) < 3 or words[0] != "Polar" or " ".join(words[1:-1]) not in models:
        return None
    is_polar = MANUFACTURER_ID in seen.manufacturer_data or HEART_RATE_SERVICE in seen.service_uuids
    return words[-1] if is_polar else None


recognise = by_advertisement("polar_h10", identify)
DRIVER = DriverEntry(PolarH10Settings, _make, recognise=recognise)
