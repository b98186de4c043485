"""Driver for the Polar Verity Sense, OH1 and 360."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from math import nan
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.ble_heart_rate.driver.beats import (
    Beat,
    PlacedBeat,
    StoredBeats,
    walk_back,
)
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.driver import DriverEntry, by_advertisement, own_settings
from biosensor_gateway.devices.polar_h10 import driver as polar
from biosensor_gateway.devices.polar_h10.driver import Plan, PolarDriver, PolarSession
from biosensor_gateway.devices.polar_h10.driver.control import ControlPoint, Wanted
from biosensor_gateway.devices.polar_h10.driver.emitter import PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    Measurement,
    Setting,
    Status,
    start,
    stop,
)
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import (
    Ppg,
    PulseInterval,
    PulseIntervals,
    RegularFrame,
)
from biosensor_gateway.devices.polar_verity_sense import SPEC
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.system.device_log import DeviceLog
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import PAIR_DESCRIPTION, Pairing, PairSetting
from biosensor_gateway.transports.nearby import Advertisement

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_ADVICE = "switch it on to its heart-rate mode, and close the apps that use it"
MODELS = frozenset({"Sense", "Verity Sense", "OH1", "360"})
"""Advertised model names; a Verity Sense advertises as ``Polar Sense``."""
DATA_NAMES: Mapping[Measurement, str] = {
    Measurement.PPG: "ppg",
    Measurement.ACCELERATION: "acc",
    Measurement.GYROSCOPE: "gyro",
    Measurement.MAGNETOMETER: "mag",
    Measurement.PULSE_INTERVALS: "ppi",
}
"""Data names of the declared streams by measurement."""
DOUBTED = frozenset({Measurement.PPG})
"""Measurements with a doubtful rate: a Verity Sense reported 135 Hz and sent 55 [1]_.

.. [1] Polar BLE SDK, documentation/KnownIssues.md, Polar Verity Sense, issue 1.
"""
GATHER_S = 0.3
"""Intervals that do not fit into one frame come in several frames in quick succession."""
_NS = 1e9
# Timestamp of intervals without a time.
_NOT_LOCATED = 0
_LIGHTS = tuple(channel.label for channel in SPEC.stream("ppg").channels)


class PolarVeritySenseSettings(DeviceSettings):
    """Settings of one Verity Sense, OH1 or 360."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the sensor, as scan shows it, or the id printed on it (8 "
        "characters); if empty, the only one in range.",
        examples=["A1B2C3D4"],
    )
    sdk_mode: bool = Field(
        default=False,
        description="Switch the sensor's SDK mode on: more rates and ranges, but neither heart "
        "rate nor pulse intervals.",
    )
    ppi: bool = Field(
        default=True,
        description="Whether the sensor sends the intervals between pulse waves, the first after "
        "25 s. With them the heart rate comes every 5 s, without them every second.",
    )
    ppg: bool = Field(default=True, description="Whether the sensor sends its light signals.")
    ppg_rate_hz: int = Field(
        default=55,
        ge=1,
        le=1000,
        description="Samples of light per second; the next lower rate that the sensor offers is "
        "used. In the SDK mode, a Verity Sense has 28, 44, 55, 135 and 176.",
    )
    acc: bool = Field(default=True, description="Whether the sensor sends its acceleration.")
    acc_rate_hz: int = Field(
        default=52,
        ge=1,
        le=1000,
        description="Samples of acceleration per second; the next lower rate that the sensor "
        "offers is used. In the SDK mode, a Verity Sense has 26, 52, 104, 208 and 416.",
    )
    acc_range_g: Literal[2, 4, 8, 16] = Field(
        default=8,
        description="Largest acceleration that can be measured, in g; 8 outside the SDK mode.",
    )
    gyro: bool = Field(
        default=True,
        description="Whether the sensor sends its rate of rotation; a Verity Sense can.",
    )
    gyro_rate_hz: int = Field(
        default=52,
        ge=1,
        le=1000,
        description="Samples of the gyroscope per second, as for acc_rate_hz.",
    )
    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = Field(
        default=2000,
        description="Fastest rotation that can be measured, in deg/s; 2000 outside the SDK mode.",
    )
    mag: bool = Field(
        default=True,
        description="Whether the sensor sends the magnetic field; a Verity Sense can.",
    )
    mag_rate_hz: Literal[10, 20, 50, 100] = Field(
        default=50, description="Samples of the magnetic field per second."
    )
    pair: PairSetting = Field(default="auto", description=PAIR_DESCRIPTION)


_VERSION_NUMBER = re.compile(r"\d+")
_VERITY_BEGIN, _VERITY_END = (1, 1, 5), (2, 1, 0)


def true_ppg_rates(info: DeviceInfo, *, sdk_mode: bool) -> Mapping[int, int]:
    """Return the real sample rates of light by the reported ones [Hz].

    A Verity Sense with firmware from 1.1.5 to before 2.1.0 reports 135 Hz and sends 55 Hz, an OH1
    reports 130 Hz and sends 135 Hz [1]_. In SDK mode the reported rates are right.

    References
    ----------
    .. [1] Polar BLE SDK, documentation/KnownIssues.md.
    """
    if sdk_mode:
        return {}
    if "OH1" in info.model:
        return {130: 135}
    if "Sense" in info.model and _VERITY_BEGIN <= _version(info) < _VERITY_END:
        return {135: 55}
    return {}


def _version(info: DeviceInfo) -> tuple[int, ...]:
    """Return the firmware version; empty if unknown, which compares as the oldest."""
    return tuple(int(number) for number in _VERSION_NUMBER.findall(info.firmware_version)[:3])


# SDK mode has more rates and ranges, but neither heart rate nor intervals.
_LEAVE_SDK_MODE = stop(Measurement.SDK_MODE)
_ENTER_SDK_MODE = start(Measurement.SDK_MODE, {})


class _SdkMode:
    """Switches SDK mode on or off before the measurements start.

    It is also switched off, because a previous host may have left it on, and then the device sends
    no heart rate.
    """

    def __init__(self, *, is_wanted: bool, log: DeviceLog) -> None:
        self._is_wanted = is_wanted
        self._log = log

    async def prepare(self, control: ControlPoint, offered: frozenset[int]) -> None:
        """Switch the mode.

        Parameters
        ----------
        offered
            Available measurements, and modes that are switched like measurements.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        AttError
            If the device does not accept a command.
        ProtocolError
            ``NO_REPLY``.
        """
        if Measurement.SDK_MODE not in offered:
            if self._is_wanted:
                self._log.warn_once("it has no SDK mode; set sdk_mode = false, or update it")
            return
        command = _ENTER_SDK_MODE if self._is_wanted else _LEAVE_SDK_MODE
        reply = await control.request(command)
        if reply.status == Status.INVALID_STATE:
            # The mode cannot be changed while a previous host's measurements are running.
            for measurement in sorted(offered & _MEASUREMENTS):
                await control.request(stop(Measurement(measurement)))
            reply = await control.request(command)
        is_there = reply.status in (Status.SUCCESS, Status.ALREADY_IN_STATE)
        if self._is_wanted and not is_there:
            self._log.warn_once("it refuses the SDK mode", cause=reply.status_text)


_MEASUREMENTS = frozenset(Measurement) - {Measurement.SDK_MODE}


def wanted_of(own: PolarVeritySenseSettings, info: DeviceInfo) -> Sequence[Wanted]:
    """Return the measurements in the settings, for a device with this information."""
    rate, reach = Setting.SAMPLE_RATE, Setting.RANGE
    light = Wanted(
        Measurement.PPG,
        {rate: own.ppg_rate_hz},
        true_ppg_rates(info, sdk_mode=own.sdk_mode),
    )
    wanted = [
        light,
        Wanted(Measurement.ACCELERATION, {rate: own.acc_rate_hz, reach: own.acc_range_g}),
        Wanted(Measurement.GYROSCOPE, {rate: own.gyro_rate_hz, reach: own.gyro_range_deg_s}),
        Wanted(Measurement.MAGNETOMETER, {rate: own.mag_rate_hz}),
        Wanted(Measurement.PULSE_INTERVALS),
    ]
    off = off_by(own)
    return [each for each in wanted if DATA_NAMES[each.measurement] not in off]


def off_by(own: PolarVeritySenseSettings) -> frozenset[str]:
    """Return the data names of the streams that the settings switch off."""
    on = {"ppi": own.ppi, "ppg": own.ppg, "acc": own.acc, "gyro": own.gyro, "mag": own.mag}
    off = {name for name, is_on in on.items() if not is_on}
    return frozenset(off | {"hr", "ppi"} if own.sdk_mode else off)


def _asked_rates(own: PolarVeritySenseSettings) -> Mapping[str, float]:
    """Return the sample rates in the settings, by data name."""
    return {
        "ppg": own.ppg_rate_hz,
        "acc": own.acc_rate_hz,
        "gyro": own.gyro_rate_hz,
        "mag": own.mag_rate_hz,
    }


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], PolarDriver]:
    """Share the emitter and the device selection between all connections."""
    own = own_settings(PolarVeritySenseSettings, settings)
    emitter = OpticalEmitter(sink)
    choice = Choice(identify, "Polar optical sensor", own.device, _ADVICE)
    plan = Plan(
        lambda info: wanted_of(own, info),
        _SdkMode(is_wanted=own.sdk_mode, log=emitter.log).prepare,
        farewell=[_LEAVE_SDK_MODE] if own.sdk_mode else [],
        has_heart_rate=not own.sdk_mode,
    )

    pairing = Pairing(own.pair)

    def meet() -> PolarSession:
        return PolarSession(BleLink(choice, sink.clock, pairing=pairing), emitter, plan)

    return lambda: PolarDriver(meet, pairing, emitter, off_by(own), _asked_rates(own))


def identify(seen: Advertisement) -> str | None:
    """Return the id printed on a Verity Sense, OH1 or 360; None for other devices."""
    return polar.identify(seen, MODELS)


recognise = by_advertisement("polar_verity_sense", identify)
DRIVER = DriverEntry(PolarVeritySenseSettings, _make, recognise=recognise)


class OpticalEmitter(PolarEmitter):
    """Converts frames and heart rates to samples; one instance per device.

    Pulse intervals come in batches and usually without a timestamp. Like a strap's intervals, they
    are placed backwards from the arrival of the batch, which ends when other data arrive.
    Intervals that the device flags as disturbed by movement are left out, but their duration
    counts. The contact flag is ignored, because its vendor calls it unreliable.
    """

    def __init__(self, sink: DeviceSink) -> None:
        strap = StrapEmitter(sink, quality=self._quality, trusts_contact=False)
        super().__init__(sink, DATA_NAMES, strap=strap, doubted=DOUBTED)
        self.on_intervals = self._intervals
        self._beats = _Beats()
        self._batch: list[PulseInterval] = []
        self._batch_s = 0.0
        self._moving = nan

    def reconnected(self) -> None:
        """Prepare for a new connection of the same device."""
        super().reconnected()
        self._end_batch()
        self._emit_placed(self._beats.restart())
        self._moving = nan

    def frame(self, data: bytes, arrival_s: float) -> None:
        """Emit the samples of a frame, and complete batches; see :class:`PolarEmitter`."""
        if arrival_s - self._batch_s > GATHER_S:
            self._end_batch()
        super().frame(data, arrival_s)

    def _regular(self, frame: RegularFrame, arrival_s: float) -> None:
        super()._regular(frame, arrival_s)
        if isinstance(frame, Ppg) and frame.counts:
            self._sink.lacking["ppg"] = _LIGHTS[len(frame.counts[0]) :]

    def _quality(self, in_contact: bool) -> Sequence[float]:
        # A heart rate arrives after all frames of a batch.
        self._end_batch()
        # Movement is reported with the intervals, which the settings may switch off.
        has_intervals = Measurement.PULSE_INTERVALS in self._running
        self._sink.lacking["quality"] = [] if has_intervals else ["moving"]
        return [float(in_contact), self._moving]

    def _intervals(self, frame: PulseIntervals, arrival_s: float) -> None:
        if not frame.intervals:
            return  # nothing is dropped: there is nothing in it
        self._moving = float(any(each.moved for each in frame.intervals))
        stamp_ns = frame.header.timestamp_ns
        if stamp_ns == _NOT_LOCATED or not self.clock_runs:
            self._batch += frame.intervals
            self._batch_s = arrival_s
            return  # nothing is dropped: `_batch` keeps it until it has a time
        # These frames are seconds late, so they are not used for the device's clock.
        lengths_s = [each.interval_ms / 1000 for each in frame.intervals]
        for each, time_s in zip(frame.intervals, walk_back(stamp_ns / _NS, lengths_s), strict=True):
            if _counts(each):
                self._sink.emit("ppi", [_sample(each)], [time_s])

    def _end_batch(self) -> None:
        batch, self._batch = self._batch, []
        if batch:
            self._emit_placed(self._beats.place(batch, self._batch_s))

    def _emit_placed(self, placed: Sequence[tuple[PulseInterval, float]]) -> None:
        for each, time_s in placed:
            if _counts(each):
                self._sink.emit_at("ppi", [_sample(each)], [time_s])


class _Beats:
    """Places intervals by their lengths, and keeps their other data."""

    def __init__(self) -> None:
        self._stored = StoredBeats(holds_first=False)
        self._waiting: list[PulseInterval] = []

    def place(
        self, intervals: Sequence[PulseInterval], arrival_s: float
    ) -> list[tuple[PulseInterval, float]]:
        """Add intervals; return those placed now, in order, with LSL times [s]."""
        self._waiting += intervals
        beats = [Beat(each.interval_ms / 1000) for each in intervals]
        return self._named(self._stored.place(beats, arrival_s))

    def restart(self) -> list[tuple[PulseInterval, float]]:
        """Restart; return the intervals held back."""
        return self._named(self._stored.restart())

    def _named(self, placed: Sequence[PlacedBeat]) -> list[tuple[PulseInterval, float]]:
        named = list(zip(self._waiting, (each.time_s for each in placed), strict=False))
        del self._waiting[: len(named)]
        return named


def _counts(interval: PulseInterval) -> bool:
    return interval.interval_ms > 0 and not interval.moved


def _sample(interval: PulseInterval) -> list[float]:
    return [interval.interval_ms / 1000, interval.error_ms / 1000]
