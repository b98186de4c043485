"""Converts BioHarness messages to samples of the declared streams."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from biosensor_common.clocks import PacketTimeline, SampleTimeline
from biosensor_common.device_clock import LONGEST_DELAY_S
from biosensor_gateway.devices.zephyr.driver.messages import (
    Acceleration,
    Event,
    General,
    Header,
    Message,
    RrIntervals,
    Summary,
    Waveform,
)
from biosensor_gateway.devices.zephyr.driver.protocol import (
    ACCELERATION_PERIOD_S,
    BREATHING_PERIOD_S,
    ECG_PERIOD_S,
    RR_PERIOD_S,
    MessageId,
)
from biosensor_gateway.system.device_log import DeviceLog

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_SEQUENCE_MODULUS = 256
# With bad contact the device reports intervals from 24 to 12 498 ms; a heart at rest beats 24 times
# a minute or more.
_RR_RANGE_S = (0.25, 2.5)
_NO_INTERVAL = (
    f"no interval between beats is below {_RR_RANGE_S[0]:g} or above {_RR_RANGE_S[1]:g} s"
)
_MAX_BRIDGED_S = 86_400.0
_REMEMBERED = 16
# Without a device clock, numbers have restarted if they show a gap longer than the arrivals allow
# by more than this.
_USUALLY_LATE_S = 5.0


@dataclass(frozen=True, slots=True)
class Placed:
    """A packet's times on the device's clock."""

    stamp_s: float  # The packet's own timestamp.
    first_s: float  # Time of its first sample, with evenly spaced samples.
    lost_packets: int  # Number of packets lost before it.


class PacketTrack:
    """Assigns times to one kind of periodic packet, over all connections.

    The packet's timestamp decides; its number confirms it, and distinguishes a gap from a clock
    that was set. So restarted or constant numbers do not cause a gap.

    Parameters
    ----------
    period_s
        Sample period in seconds.
    stamped_at_end
        Whether the timestamp is the time at which the packet is complete instead of that of its
        first sample.
    """

    def __init__(self, samples: int, period_s: float, *, stamped_at_end: bool = False) -> None:
        self.samples = samples
        self._duration_s = samples * period_s
        self._period_s = period_s
        self._age_s = 0.0 if stamped_at_end else self._duration_s
        self._timeline = SampleTimeline(period_s)
        self._numbers = PacketTimeline(_SEQUENCE_MODULUS)
        # nothing is dropped: these only tell a packet that comes again
        self._stamped: deque[Header] = deque(maxlen=_REMEMBERED)
        self._next_s: float | None = None
        self._arrival_s = 0.0

    def reconnected(self) -> None:
        """Forget the sequence number, which may not continue in a new connection."""
        self._numbers.forget()

    def place(self, header: Header, arrival_s: float) -> Placed | None:
        """Return the times of the next packet; None for a repeated one.

        If the device's clock was never set, times count from the arrival of the connection's first
        packet.
        """
        if self._came_before(header, arrival_s):
            return None  # nothing is dropped: the emitter reports it as left out
        stamp = header.device_s
        if stamp is None:
            stamp = self._counted_stamp(header.sequence, arrival_s)
        else:
            self._stamped.append(header)
        lost = self._lost(header.sequence, stamp, arrival_s)
        self._numbers.place(header.sequence)
        first = self._timeline.place(stamp, self.samples, lost * self.samples)
        self._arrival_s = arrival_s
        self._next_s = first + self._duration_s
        return Placed(stamp, first, lost)

    def times(self, first_s: float) -> list[float]:
        """Return the device time of each sample of a packet."""
        return [first_s + index * self._period_s for index in range(self.samples)]

    def _came_before(self, header: Header, arrival_s: float) -> bool:
        if header.device_s is not None:
            return header in self._stamped
        is_same = self._numbers.steps(header.sequence, 0.0, None) == 0
        return is_same and arrival_s - self._arrival_s < self._duration_s / 2

    def _counted_stamp(self, sequence: int, arrival_s: float) -> float:
        steps = self._numbers.steps(sequence)
        if steps is None or self._next_s is None:
            return arrival_s - self._age_s
        missing_s = (steps - 1) * self._duration_s
        pause_s = self._pause_s(arrival_s)
        if missing_s > pause_s + _USUALLY_LATE_S:
            missing_s = max(0, round(pause_s / self._duration_s)) * self._duration_s
        return self._next_s + missing_s

    def _lost(self, sequence: int, stamp_s: float, arrival_s: float) -> int:
        by_time = self._lost_by_time(stamp_s, arrival_s)
        is_next = self._numbers.steps(sequence) == 1
        # If the numbers are consecutive but the time jumps, the device's clock was set.
        return 0 if is_next and by_time % _SEQUENCE_MODULUS else by_time

    def _lost_by_time(self, stamp_s: float, arrival_s: float) -> int:
        if self._next_s is None:
            return 0
        missing_s = stamp_s - self._next_s
        pause_s = self._pause_s(arrival_s)
        if abs(missing_s - pause_s) > LONGEST_DELAY_S:
            # The device's clock was set meanwhile, so the host's clock determines the pause.
            missing_s = pause_s
        if missing_s > _MAX_BRIDGED_S:
            return 0
        return max(0, round(missing_s / self._duration_s))

    def _pause_s(self, arrival_s: float) -> float:
        """Return the time since the last packet minus its duration."""
        return arrival_s - self._arrival_s - self._duration_s


class BeatDetector:
    """Finds new beats in R-R packets, where the reading changes.

    The first reading after a start or a gap does not count, because its beat may be old.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def reset(self) -> None:
        """Forget the last reading, for example after lost packets."""
        self._last = None

    def beats(self, packet: RrIntervals) -> list[tuple[int, float]]:
        """Return (index of the reading, R-R interval in s) of each new beat."""
        found: list[tuple[int, float]] = []
        for index, reading in enumerate(packet.samples):
            if self._last is not None and reading not in (0, self._last):
                found.append((index, abs(reading) / 1000))
            self._last = reading
        return found


_WAVEFORMS = {MessageId.ECG: "ecg", MessageId.BREATHING: "breathing"}
_VITALS_PERIOD_S = 1.0
_NAN = math.nan
_OF_SUMMARIES = ("hr_confidence", "br_unreliable", "hrv_unreliable", "link_quality")
"""Channels of ``quality`` of which a general data packet says nothing."""


class ZephyrEmitter:
    """Converts messages to samples; one instance per device, over all its connections."""

    def __init__(self, sink: DeviceSink) -> None:
        self._sink = sink
        self._log = DeviceLog("biosensor_gateway.zephyr", sink.identity)
        self._tracks = {
            "ecg": PacketTrack(63, ECG_PERIOD_S),
            "breathing": PacketTrack(18, BREATHING_PERIOD_S),
            "acc": PacketTrack(20, ACCELERATION_PERIOD_S),
            "ibi": PacketTrack(18, RR_PERIOD_S),
            "vitals": PacketTrack(1, _VITALS_PERIOD_S, stamped_at_end=True),
        }
        self._beats = BeatDetector()
        self._quality = [_NAN] * 6
        self._vitals: set[str] = set()

    def reconnected(self) -> None:
        """Prepare for a new connection of the same device."""
        for track in self._tracks.values():
            track.reconnected()
        self._beats.reset()

    def take(self, message: Message, arrival_s: float) -> None:
        """Emit the samples of a message; messages without values are ignored.

        Parameters
        ----------
        arrival_s
            LSL time of arrival of the message's last byte.
        """
        match message:
            case Waveform():
                name = _WAVEFORMS[message.message_id]
                self._samples(name, message.header, message.samples, arrival_s)
            case Acceleration():
                scale, zero = message.counts_per_g, message.zero
                samples = [[(count - zero) / scale for count in xyz] for xyz in message.samples]
                self._samples("acc", message.header, samples, arrival_s)
            case RrIntervals():
                self._rr(message, arrival_s)
            case Summary():
                self._summary(message, arrival_s)
            case General():
                self._general(message, arrival_s)
            case Event():
                self._event(message)
            case _:
                pass

    def _placed(self, track: str, header: Header, arrival_s: float) -> Placed | None:
        """Return the times of a packet; None for a repeated one."""
        placed = self._tracks[track].place(header, arrival_s)
        if placed is None:
            self._sink.left_out(self._tracks[track].samples, "their packet came twice")
        return placed

    def _times(self, track: str, placed: Placed, arrival_s: float) -> list[float]:
        times = self._tracks[track].times(placed.first_s)
        self._sink.observe(times[-1], arrival_s, track)
        return times

    def _samples(
        self, data_name: str, header: Header, samples: ArrayLike, arrival_s: float
    ) -> None:
        placed = self._placed(data_name, header, arrival_s)
        if placed is None:
            return  # nothing is dropped: `_placed` counts it
        times = self._times(data_name, placed, arrival_s)
        if placed.lost_packets:
            self._sink.lost(data_name, placed.lost_packets * len(times))
        self._sink.emit(data_name, samples, times)

    def _rr(self, message: RrIntervals, arrival_s: float) -> None:
        placed = self._placed("ibi", message.header, arrival_s)
        if placed is None:
            return  # nothing is dropped: `_placed` counts it
        times = self._times("ibi", placed, arrival_s)
        if placed.lost_packets:
            # The number of beats in the gap is unknown, so none is counted as lost.
            self._beats.reset()
        for index, interval_s in self._beats.beats(message):
            if _RR_RANGE_S[0] <= interval_s <= _RR_RANGE_S[1]:
                self._sink.emit_value("ibi", interval_s, times[index])
            else:
                self._sink.left_out(1, _NO_INTERVAL)

    def _emit_vitals(
        self, header: Header, values: dict[str, float | None], arrival_s: float
    ) -> None:
        placed = self._placed("vitals", header, arrival_s)
        if placed is None:
            return  # nothing is dropped: `_placed` counts it
        time_s = placed.stamp_s
        self._sink.observe(time_s, arrival_s, "vitals")
        for data_name in self._vitals if placed.lost_packets else ():
            # Estimated: lost packets are assumed to have the same values as the previous one.
            self._sink.lost(data_name, placed.lost_packets)
        # nothing is dropped: these are names
        self._vitals = {"quality", *(name for name, value in values.items() if value is not None)}
        for data_name, value in values.items():
            self._sink.emit_value(data_name, value, time_s)
        self._sink.emit("quality", [self._quality], [time_s])

    def _summary(self, message: Summary, arrival_s: float) -> None:
        numbers, flags = message.numbers, message.status.flags
        self._sink.lacking["quality"] = ()
        self._quality = [
            float(message.status.worn),
            _number(numbers["heart_rate_confidence"]),
            float(flags["hr_unreliable"]),
            float(flags["rr_unreliable"]),
            float(flags["hrv_unreliable"]),
            _number(numbers["link_quality"]),
        ]
        values = {
            "hr": _rate(numbers["heart_rate_bpm"]),
            "hrv": numbers["hrv_ms"],
            # This flag alone invalidates a value; the others are only emitted as quality.
            "br": None if flags["rr_unreliable"] else _rate(numbers["respiration_rate_bpm"]),
            "posture": numbers["posture_deg"],
            "activity": numbers["activity_vmu_g"],
            "st": numbers.get("skin_temperature_c"),
            "bat": numbers["battery_percent"],
            "rssi": numbers["rssi_db"],
        }
        self._emit_vitals(message.header, values, arrival_s)

    def _general(self, message: General, arrival_s: float) -> None:
        numbers = message.numbers
        unreliable = float(message.hr_signal_low)
        self._quality = [float(message.worn), _NAN, unreliable, _NAN, _NAN, _NAN]
        self._sink.lacking["quality"] = _OF_SUMMARIES
        values = {
            "hr": _rate(numbers["heart_rate_bpm"]),
            "br": _rate(numbers["respiration_rate_bpm"]),
            "posture": numbers["posture_deg"],
            "activity": numbers["activity_vmu_g"],
            "st": numbers["skin_temperature_c"],
            "bat": message.battery_percent,
        }
        self._emit_vitals(message.header, values, arrival_s)

    def _event(self, message: Event) -> None:
        # nothing is dropped: an event is no sample
        self._log.info("event", name=message.name)
        if message.name == "worn_change" and len(message.data) >= 2:
            self._quality[0] = float(message.data[1] > 0)
            if message.header.device_s is not None and self._vitals:
                self._sink.emit("quality", [self._quality], [message.header.device_s])


def _rate(value: float | None) -> float | None:
    """Return a rate; the device reports 0 while it is unknown."""
    return value or None


def _number(value: float | None) -> float:
    return _NAN if value is None else value
