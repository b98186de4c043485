"""Driver for the Shimmer3 GSR+, and its settings."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isfinite
from statistics import median
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from biosensor_gateway.devices.driver import Connected, DriverEntry, by_port_name, own_settings
from biosensor_gateway.devices.shimmer.driver import messages
from biosensor_gateway.devices.shimmer.driver.calibration import (
    ADC_MAX,
    ADC_VOLTS,
    Floats,
    Ints,
    millivolts,
)
from biosensor_gateway.devices.shimmer.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer.driver.connection import Prepared, ShimmerDriver
from biosensor_gateway.devices.shimmer.driver.conversation import (
    Conversation,
    Kind,
    ask_for_the_state,
    expansion_board,
    make_right,
)
from biosensor_gateway.devices.shimmer.driver.messages import AUTO_RANGE, TICKS_PER_S, Inquiry
from biosensor_gateway.devices.shimmer.driver.packets import Batch, PacketEmitter
from biosensor_gateway.devices.shimmer3_gsr import SPEC
from biosensor_gateway.pulses import Pulses
from biosensor_gateway.settings.models import DeviceSettings

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

GSR_BOARDS = frozenset({14, 48})
QUALITY_PERIOD_S = 10.0
WAVEFORMS = ("gsr", "ppg")

# Pulses are detected as in the live features; the heart rate is the median of five plausible
# intervals. The device sends no heart rate, and the vendor's software computes its own in a closed
# library, which is not reproduced here.
SMALLEST_PEAK_MV = 0.5
LONGEST_INTERVAL_S = 2.0
MOST_DEVIATION = 0.35
BEATS_NEEDED = 5
INTERVALS_KEPT = 5
MISFITS_TOLERATED = 3
"""After this many implausible intervals in a row, the earlier ones are considered wrong."""
LONGEST_GAP_S = 0.25
"""After a longer gap in the signal a beat may be missing, so the detection restarts."""


class ShimmerSettings(DeviceSettings):
    """Settings of one Shimmer3 GSR+."""

    port: str = Field(
        min_length=1,
        description="Serial port of the paired Shimmer, COM7 or /dev/rfcomm0 for instance, or its "
        "Bluetooth address, 00:06:66:AA:BB:CC for instance, or socket://HOST:NUMBER.",
        examples=["/dev/rfcomm0"],
    )
    rate_hz: float = Field(
        default=128.0,
        ge=51.2,
        le=1024.0,
        description="Sampling rate in Hz; the device uses the nearest rate that divides 32768.",
    )
    gsr_range: Literal["auto", 0, 1, 2, 3] = Field(
        default="auto",
        description="Range of the skin conductance: auto, or fixed to 0 (15.9 to 125 microsiemens),"
        " 1 (4.5 to 15.9), 2 (1.5 to 4.5) or 3 (0.2 to 1.5).",
    )


class Wanted(NamedTuple):
    """Wanted setup: sample rate divisor, and feedback resistor (4 for automatic)."""

    divisor: int
    gsr_setting: int


async def set_up(talk: Conversation, kind: Kind, wanted: Wanted, name: str) -> Measurement:
    """Set up the device for skin conductance and pulse, without starting it.

    Settings are written to the device's flash, so correct ones are not written again.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if it does not accept a setting, or as for :meth:`Conversation.ask`.
    TransportError
        As :meth:`Conversation.ask`.
    """
    board = await expansion_board(talk, name)
    remarks: dict[str, str] = {}
    if board is not None and board not in GSR_BOARDS:
        remarks["board"] = (
            f"the expansion board ({board}) is not a GSR+ board, so gsr and ppg have no meaning"
        )
    denied = await ask_for_the_state(talk, kind)
    present = await make_right(talk, lambda inquiry: _changes(inquiry, wanted), name)
    layout = kind.layout(present.channels)
    return Measurement(layout, wanted.divisor, wanted.gsr_setting, denied, remarks)


def _changes(present: Inquiry, wanted: Wanted) -> dict[str, bytes]:
    """Return the necessary commands by the setting that they change."""
    right = {
        "sensors": set(present.channels) == {Channel.GSR, Channel.PPG},
        "GSR range": present.gsr_range == wanted.gsr_setting,
        "power of the optical probe": present.expansion_power,
        "sampling rate": present.divisor == wanted.divisor,
    }
    setting = {
        "sensors": messages.set_sensors(messages.GSR_AND_PPG),
        "GSR range": messages.set_gsr_range(wanted.gsr_setting),
        "power of the optical probe": messages.POWER_THE_PROBE,
        "sampling rate": messages.set_sampling_rate(wanted.divisor),
    }
    return {name: command for name, command in setting.items() if not right[name]}


def _wanted(settings: ShimmerSettings) -> Wanted:
    setting = messages.AUTO_RANGE if settings.gsr_range == "auto" else settings.gsr_range
    return Wanted(messages.divisor_for(settings.rate_hz), setting)


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], ShimmerDriver]:
    """Share one emitter between all connections, to follow the device's clock across them."""
    own = own_settings(ShimmerSettings, settings)
    emitter = GsrEmitter(sink)
    wanted = _wanted(own)

    async def prepare(talk: Conversation, kind: Kind) -> Prepared:
        measurement = await set_up(talk, kind, wanted, own.port)
        rates = {
            name: measurement.rate_hz
            for name in WAVEFORMS
            if measurement.rate_hz != SPEC.stream(name).rate
        }
        begin = partial(emitter.started, measurement)
        connected = Connected(rates=rates, denied=measurement.denied)
        layout, divisor = measurement.layout, measurement.divisor
        return Prepared(layout, divisor, begin, connected, measurement.remarks)

    return lambda: ShimmerDriver(own.port, sink, emitter, prepare)


recognise = by_port_name("shimmer3_gsr", r"Shimmer3-([0-9A-Fa-f]{4})")
DRIVER = DriverEntry(ShimmerSettings, _make, recognise=recognise)


class HeartRate(NamedTuple):
    """Heart rate at a beat: device time of the pulse peak [s], and rate [1/min]."""

    time_s: float
    bpm: float


class PulseRate:
    """Computes the heart rate from a pulse signal, sample by sample.

    The time of a peak is that of the filtered signal, from 40 ms before (at 35 beats per minute)
    to 20 ms after (at 165) the pulse at the finger. Rates up to 200/min are detected.

    Parameters
    ----------
    rate_hz
        Sample rate, 25 Hz or more.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        # nothing is dropped: of these the median is taken
        self._intervals: deque[float] = deque(maxlen=INTERVALS_KEPT)
        self._restart()

    def feed(self, time_s: float, millivolts: float) -> list[HeartRate]:
        """Process a sample; return the heart rate at each beat detected.

        Parameters
        ----------
        time_s
            Device time, later than that of all previous samples.
        millivolts
            The raw signal, with its offset.
        """
        if time_s - self._latest_s > LONGEST_GAP_S:
            self._restart()
        self._latest_s = time_s
        found = self._pulses.take(time_s, millivolts)
        if self._pulses.height < SMALLEST_PEAK_MV:
            return []  # nothing is dropped: the wave itself is emitted
        return [rate for beat in found for rate in self._beat(beat.apex_s)]

    def found(self, time_s: float) -> bool:
        """Whether there is a pulse: a heart rate is known, and no beat is overdue at this time."""
        return self._has_rate and time_s - self._last_beat_s <= LONGEST_INTERVAL_S

    @property
    def _has_rate(self) -> bool:
        return len(self._intervals) >= BEATS_NEEDED - 1

    def _restart(self) -> None:
        self._pulses = Pulses(self._rate_hz)
        self._latest_s = self._last_beat_s = float("-inf")
        self._misfits = 0
        self._intervals.clear()

    def _beat(self, peak_s: float) -> list[HeartRate]:
        interval_s = peak_s - self._last_beat_s
        self._last_beat_s = peak_s
        if interval_s > LONGEST_INTERVAL_S:
            self._intervals.clear()
            return []  # nothing is dropped: the first beat after a pause ends no interval
        if not self._fits(interval_s):
            self._misfits += 1
            if self._misfits >= MISFITS_TOLERATED:
                self._intervals.clear()
            return []  # nothing is dropped: the wave is emitted, and has no beat here
        self._misfits = 0
        self._intervals.append(interval_s)
        return [HeartRate(peak_s, 60 / median(self._intervals))] if self._has_rate else []

    def _fits(self, interval_s: float) -> bool:
        if not self._intervals:
            return True
        usual_s = median(self._intervals)
        return abs(interval_s - usual_s) <= MOST_DEVIATION * usual_s


# The GSR+ unit applies 0.5 V to the skin and amplifies the current with one of four feedback
# resistors, so the ADC measures 0.5 V * (1 + Rf / Rskin). Constants and limits are from Shimmer's
# Java and C# APIs.
FEEDBACK_KOHM = (40.2, 287.0, 1000.0, 3300.0)
LARGEST_OPEN_ADC = 683
"""In range 3, the amplifier's output without any current, rounded up."""

_EXCITATION_VOLTS = 0.5
_RANGE_SHIFT = 14
_ADC_MASK = 0x0FFF
_AUTO_LIMITS_KOHM = (8.0, np.inf)
_FIXED_LIMITS_KOHM = ((8.0, 63.0), (63.0, 220.0), (220.0, 680.0), (680.0, 4700.0))


def gsr_ranges(raw: ArrayLike, setting: int) -> Ints:
    """Return the feedback resistor in use for each sample, 0 to 3.

    Parameters
    ----------
    raw : array_like of int, shape (n,)
        16-bit values of the GSR channel.
    setting : int
        0 to 3, or 4 for automatic; only then the upper bits contain the resistor.
    """
    raw = np.asarray(raw, np.int64)
    return raw >> _RANGE_SHIFT if setting == AUTO_RANGE else np.full(raw.shape, setting)


def conductance_us(raw: ArrayLike, setting: int) -> Floats:
    """Return the skin conductance in microsiemens; NaN where no current flows.

    Parameters
    ----------
    raw, setting
        As for `gsr_ranges`.

    Returns
    -------
    ndarray of float, shape (n,)
        With a fixed range, resistances are clipped to it, as in the vendor's APIs.
    """
    ranges = gsr_ranges(raw, setting)
    adc = np.asarray(raw, np.int64) & _ADC_MASK
    volts = adc * ADC_VOLTS / ADC_MAX
    # In range 3, an ADC value near 0.5 V does not show whether a current flows.
    flows = (volts > _EXCITATION_VOLTS) & ((ranges != 3) | (adc > LARGEST_OPEN_ADC))
    gain = np.where(flows, volts / _EXCITATION_VOLTS - 1, np.nan)
    resistance = np.take(FEEDBACK_KOHM, ranges) / gain
    return 1000.0 / clamped_kohm(resistance, setting)


def clamped_kohm(resistance: ArrayLike, setting: int) -> Floats:
    """Clip resistances [kohm] to the range of a setting; NaN stays NaN."""
    limits = _AUTO_LIMITS_KOHM if setting == AUTO_RANGE else _FIXED_LIMITS_KOHM[setting]
    return np.clip(np.asarray(resistance, np.float64), *limits)


@dataclass(frozen=True, slots=True)
class Measurement:
    """The setup of a device."""

    layout: Layout
    divisor: int  # The sample rate is 32768 Hz divided by it.
    gsr_setting: int  # Feedback resistor, 4 for automatic.
    # What the device refuses and why, by data name; and why values may be wrong.
    denied: Mapping[str, str] = field(default_factory=dict[str, str])
    remarks: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def rate_hz(self) -> float:
        """Sample rate."""
        return TICKS_PER_S / self.divisor


class GsrEmitter(PacketEmitter):
    """Converts packets to samples; one instance per device, over all its connections."""

    def __init__(self, sink: DeviceSink) -> None:
        super().__init__(sink, "shimmer3_gsr")
        self._measurement: Measurement | None = None
        self._quality: list[float] = []
        self._quality_s = 0.0

    def started(self, measurement: Measurement) -> None:
        """Prepare for packets of a new connection."""
        self._measurement = measurement
        self._expect(measurement.divisor, WAVEFORMS)
        self._gsr_at = measurement.layout.index(Channel.GSR)
        self._ppg_at = measurement.layout.index(Channel.PPG)
        self._pulse = PulseRate(measurement.rate_hz)
        self._quality = []

    def _emit(self, batch: Batch) -> None:
        assert self._measurement is not None
        times = batch.times
        raw = [row[self._gsr_at] for row in batch.rows]
        setting = self._measurement.gsr_setting
        gsr = conductance_us(raw, setting)
        ppg = millivolts([row[self._ppg_at] for row in batch.rows])
        self._sink.emit("gsr", gsr, times)
        self._sink.emit("ppg", ppg, times)
        self._emit_heart_rate(times, ppg)
        closed = isfinite(gsr[-1])
        self._emit_quality(times[-1], closed, int(gsr_ranges(raw[-1:], setting)[0]))

    def _emit_heart_rate(self, times: Sequence[float], ppg: Floats) -> None:
        for time_s, value in zip(times, ppg.tolist(), strict=True):
            for rate in self._pulse.feed(time_s, value) if isfinite(value) else ():
                self._sink.emit_value("hr", rate.bpm, rate.time_s)

    def _emit_quality(self, time_s: float, closed: bool, gsr_range: int) -> None:
        quality = [float(closed), float(gsr_range), float(self._pulse.found(time_s))]
        if quality != self._quality or time_s - self._quality_s >= QUALITY_PERIOD_S:
            self._quality, self._quality_s = quality, time_s
            self._sink.emit("quality", [quality], [time_s])
