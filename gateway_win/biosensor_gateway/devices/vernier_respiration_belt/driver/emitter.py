"""Converts a belt's messages to samples of the declared streams."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from statistics import fmean, pstdev
from typing import TYPE_CHECKING, NamedTuple

from biosensor_common.clocks import PacketTimeline
from biosensor_common.device_clock import ClockState
from biosensor_gateway.devices.vernier_respiration_belt.driver.conversation import BeltChannels
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    Measurement,
    MeasurementKind,
    Message,
    Notice,
    Status,
)
from biosensor_gateway.system.device_log import DeviceLog

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

HELD_PACKETS = 5
"""Of this many packets, the one with the smallest delay is hardly delayed."""
SILENCE_S = 1.0
SILENCE_PERIODS = 5
PAUSE_S = 0.15
PAUSE_PERIODS = 1.5
"""After a longer pause samples are missing, whatever the counter says: belts were seen to pause for
half a second every few seconds."""
BACKLOG_PACE = 0.5
"""Stored packets arrive within less than this fraction of their duration."""
EARLY_PERIODS = 0.25
"""Tolerance by which the clock may be later than the least delayed packet."""
LOST_LIMIT_S = 60.0
"""After a longer absence the belt was off, so nothing was measured and nothing is lost."""

_TRUSTED_STEPS = 3


class Arrived(NamedTuple):
    """A measurement without a time yet."""

    measurement: Measurement
    samples: int  # Number of samples per channel, at least 1.
    arrival_s: float
    waited_s: float = 0.0  # How long it may have waited for a busy computer.
    is_behind_pause: bool = False  # Whether it arrived later than the duration of its samples.


class Placed(NamedTuple):
    """A measurement with its time on the device's clock."""

    measurement: Measurement
    arrival_s: float
    last_s: float  # Device time of the last sample.
    lost: int  # Estimated number of samples missing before it.
    # Whether it is the first one after a start, whose time relative to earlier ones is not exact.
    is_first: bool = False


class Numbering:
    """Counts the samples of one belt, over all its connections.

    Parameters
    ----------
    clock
        Returns the device clock, which observes the last sample of every placed packet.
    """

    def __init__(self, clock: Callable[[], ClockState]) -> None:
        self._clock = clock
        self._period_s = 1.0
        self._origin_s = 0.0
        self._index = 0
        self._restarted = True
        self._counter = _PacketCounter()
        self._suspicious = False
        self._has_jumped = False
        self._may_be_stored = False
        self._arrival_s = -math.inf
        self._stored_s = -math.inf
        self._held: list[Arrived] = []

    def restart(self, period_s: float) -> None:
        """Restart the count with the first sample after a start."""
        self._origin_s, self._index = self._time(0), 0
        self._period_s = period_s
        self._restarted = True
        self._suspicious = self._has_jumped = self._may_be_stored = False
        self._counter = _PacketCounter()

    def count(self, counter: int) -> None:
        """Add the packet counter of any packet; call this before :meth:`place`."""
        if self._counter.jumps(counter):
            self.suspect()

    def suspect(self) -> None:
        """Expect missing samples before the next packet, because the belt reports them."""
        self._suspicious = self._has_jumped = True

    def place(self, packet: Arrived) -> list[Placed]:
        """Return the packets whose times are certain now, in order; none while unclear."""
        pause = packet.arrival_s - self._arrival_s
        self._arrival_s = packet.arrival_s
        if self._restarted:
            return [self._place_first(packet)]
        if pause > max(SILENCE_S, SILENCE_PERIODS * self._period_s):
            self._suspicious = self._may_be_stored = True
        elif pause - packet.samples * self._period_s > max(PAUSE_S, PAUSE_PERIODS * self._period_s):
            self._suspicious = True
            packet = packet._replace(is_behind_pause=True)
        if not self._suspicious:
            return [self._place_next(packet)]
        self._held.append(packet)
        return self._place_certain()

    def release(self) -> list[Placed]:
        """Return the packets held back, because no more packets arrive."""
        if not self._held or self._ends_backlog or _is_backlog(self._held, self._period_s):
            return self._place_held(len(self._held))
        return self._place_by_pauses(least=1)

    @property
    def _ends_backlog(self) -> bool:
        """Whether the packets held back arrived right behind stored ones, however few they are."""
        held_s = sum(packet.samples for packet in self._held) * self._period_s
        return self._held[-1].arrival_s - self._stored_s < BACKLOG_PACE * held_s

    def _place_first(self, packet: Arrived) -> Placed:
        """Continue at the host's time, because a start can happen at any moment."""
        self._restarted = False
        earliest_s = self._time(packet.samples)
        reached_s = self._device_time(packet.arrival_s)
        missing_s = reached_s - earliest_s
        lost = round(missing_s / self._period_s) if 0.0 < missing_s < LOST_LIMIT_S else 0
        self._origin_s, self._index = max(earliest_s, reached_s), 0
        return Placed(packet.measurement, packet.arrival_s, self._origin_s, lost, is_first=True)

    def _place_next(self, packet: Arrived, lost: int = 0) -> Placed:
        self._index += lost + packet.samples
        return Placed(packet.measurement, packet.arrival_s, self._time(0), lost)

    def _place_certain(self) -> list[Placed]:
        """Place the packets held back, as far as the cause of their delay is clear."""
        placed: list[Placed] = []
        while len(self._held) >= HELD_PACKETS:
            if _is_backlog(self._held[:HELD_PACKETS], self._period_s):
                # Whether the backlog is complete is only known later.
                self._may_be_stored = True
                self._stored_s = self._held[HELD_PACKETS - 1].arrival_s
                placed += self._place_held(HELD_PACKETS)
                continue  # nothing is dropped: they are placed
            lost = self._missing(0, HELD_PACKETS)
            if lost and self._may_be_stored:
                later = self._held[HELD_PACKETS:]
                if len(later) < HELD_PACKETS:
                    break
                if _is_backlog(later, self._period_s) or self._missing(HELD_PACKETS) != lost:
                    placed += self._place_held(HELD_PACKETS)
                    continue  # nothing is dropped: they are placed
            # What this computer may have delayed is judged again once it is less busy.
            is_unclear = self._missing() != self._missing(is_computer_prompt=True)
            placed += self._place_by_pauses()
            self._suspicious, self._may_be_stored = is_unclear or bool(self._held), False
            self._has_jumped = self._has_jumped and bool(self._held)
        return placed

    def _place_by_pauses(self, least: int = HELD_PACKETS) -> list[Placed]:
        """Place the packets held back between pauses, if enough packets follow each pause."""
        begins = [at for at, each in enumerate(self._held) if not at or each.is_behind_pause]
        known = [at for at in begins if len(self._held) - at >= least]
        missing = [self._missing(at) for at in known]
        ends = [*begins[1:], len(self._held)][: len(known)]
        placed: list[Placed] = []
        before = 0
        for begin, end, lost in zip(known, ends, missing, strict=True):
            placed += self._place_held(end - begin, max(0, lost - before))
            before = max(before, lost)
        return placed

    def _place_held(self, count: int, lost: int = 0) -> list[Placed]:
        held, self._held = self._held[:count], self._held[count:]
        return [self._place_next(each, 0 if at else lost) for at, each in enumerate(held)]

    def _missing(
        self, begin: int = 0, end: int | None = None, *, is_computer_prompt: bool = False
    ) -> int:
        """Return the number of samples that fit into the smallest delay of held packets.

        Unless the belt says that samples are missing, or `is_computer_prompt`, the time for which
        a packet may have waited for this computer is no part of its delay.
        """
        samples = sum(packet.samples for packet in self._held[:begin])
        least_s = math.inf
        for packet in self._held[begin:end]:
            samples += packet.samples
            late_s = self._device_time(packet.arrival_s) - self._time(samples)
            if not (self._has_jumped or is_computer_prompt):
                late_s -= packet.waited_s
            least_s = min(least_s, late_s)
        return max(0, math.floor(least_s / self._period_s + EARLY_PERIODS))

    def _time(self, ahead: int) -> float:
        """Return the device time of a sample `ahead` samples after the last placed one."""
        return self._origin_s + (self._index + ahead) * self._period_s

    def _device_time(self, arrival_s: float) -> float:
        """Return the device time of a sample that arrived without delay."""
        state = self._clock()
        if math.isnan(state.offset_s):
            return self._time(0)
        newest_s = self._time(0)
        return newest_s + (arrival_s - newest_s - state.offset_s) / (1 + state.drift_ppm * 1e-6)


def _is_backlog(held: Sequence[Arrived], period_s: float) -> bool:
    """Whether packets arrived so fast that they must have been stored."""
    measured_s = sum(packet.samples for packet in held[1:]) * period_s
    return held[-1].arrival_s - held[0].arrival_s < BACKLOG_PACE * measured_s


class _PacketCounter:
    """Detects jumps of the packet counter, once it is known to count packets."""

    def __init__(self) -> None:
        self._numbers = PacketTimeline(256)
        self._in_a_row = 0

    def jumps(self, counter: int) -> bool:
        is_next = self._numbers.place(counter) in (None, 1)
        is_trusted = self._in_a_row >= _TRUSTED_STEPS
        if not is_trusted:
            self._in_a_row = self._in_a_row + 1 if is_next else 0
        return is_trusted and not is_next


QUALITY_PERIOD_S = 10.0

LOOSE = -1.0
GOOD = 0.0
TIGHT = 1.0

LOOSE_BELOW_N = 1.0
TIGHT_ABOVE_N = 40.0
JUDGED_S = 3.0
"""About one breath, so that single samples do not matter."""
FLAT_BELOW_N = 0.02
FLAT_FOR_S = 10.0
"""If the force stays this flat for this long, the belt is not worn."""


class _Fit:
    """Evaluates the tension of the belt from the last seconds of the force."""

    def __init__(self, period_s: float) -> None:
        # nothing is dropped: these are copies, of which the quality is told
        self._breath: deque[float] = deque(maxlen=max(1, round(JUDGED_S / period_s)))
        # nothing is dropped: these, too
        self._still: deque[float] = deque(maxlen=max(2, round(FLAT_FOR_S / period_s)))

    def add(self, forces: Iterable[float]) -> None:
        """Add samples in newtons; NaN is ignored."""
        # nothing is dropped: these are copies, of which the quality is told
        finite = [force for force in forces if math.isfinite(force)]
        self._breath.extend(finite)
        self._still.extend(finite)

    @property
    def tension(self) -> float:
        """-1 loose or not worn, 0 good, 1 tight; NaN before the first sample."""
        if not self._breath:
            return math.nan
        mean = fmean(self._breath)
        if mean < LOOSE_BELOW_N or self._is_flat():
            return LOOSE
        return TIGHT if mean > TIGHT_ABOVE_N else GOOD

    def _is_flat(self) -> bool:
        return len(self._still) == self._still.maxlen and pstdev(self._still) < FLAT_BELOW_N


class VernierEmitter:
    """Converts messages to samples; one instance per device, over all its connections."""

    def __init__(self, sink: DeviceSink) -> None:
        self._sink = sink
        self.log = DeviceLog("biosensor_gateway.vernier", sink.identity)
        self._numbering = Numbering(lambda: sink.clock_state)
        self._force = self._rate = -1
        self._period_s = 1.0
        self._last_s: float | None = None
        self._fit = _Fit(self._period_s)
        self._rate_valid = 0.0
        self._quality = (math.nan, math.nan)
        self._quality_s = -math.inf

    def started(self, channels: BeltChannels, period_s: float) -> None:
        """Expect the samples of a new start of the belt, every ``period_s`` seconds."""
        self.ended()
        self._force, self._rate = channels.force.number, channels.rate.number
        self._period_s = period_s
        self._numbering.restart(period_s)
        self._fit = _Fit(period_s)

    def ended(self) -> None:
        """Emit the packets held back, because no more arrive before the next start."""
        for placed in self._numbering.release():
            self._emit(placed)

    def take(self, message: Message, arrival_s: float) -> None:
        """Emit the samples of a message.

        Parameters
        ----------
        arrival_s
            LSL time of arrival of the message's last byte.
        """
        self._numbering.count(message.counter)
        if isinstance(message, Notice) and message.kind is MeasurementKind.DROPPED:
            # nothing is dropped: the next counter says how many
            self.log.warning("the belt dropped samples")
            self._numbering.suspect()
        if isinstance(message, Measurement):
            self._measurement(message, arrival_s)

    def take_status(self, status: Status, arrival_s: float) -> None:
        """Emit the battery level."""
        self._sink.emit_at("bat", [status.battery_percent], [arrival_s])

    def take_rssi(self, rssi_dbm: int | None, arrival_s: float) -> None:
        """Emit the signal strength of an advertisement; None is ignored."""
        if rssi_dbm is not None:
            self._sink.emit_at("rssi", [rssi_dbm], [arrival_s])

    def _measurement(self, message: Measurement, arrival_s: float) -> None:
        count = len(message.samples.get(self._force, ()))
        if count:
            packet = Arrived(message, count, arrival_s, self._sink.own_delay())
            for placed in self._numbering.place(packet):
                self._emit(placed)
        elif self._last_s is not None:
            # Belts send both channels together; otherwise the force determines the time.
            self._emit_rate(message, self._last_s)
        else:
            # Before the first force sample, the time of a rate is unknown.
            self._sink.lost("bpm", len(message.samples.get(self._rate, ())))

    def _emit(self, placed: Placed) -> None:
        if placed.lost:
            self._lost(placed.lost)
        forces = placed.measurement.samples[self._force]
        self._last_s = placed.last_s
        if placed.is_first:
            # The delay of a start must not be mistaken for drift.
            self._sink.restart_clock()
        self._sink.observe(placed.last_s, placed.arrival_s)
        self._sink.emit("force", forces, self._times(len(forces), placed.last_s))
        self._emit_rate(placed.measurement, placed.last_s)
        self._fit.add(forces)
        self._emit_quality(placed.last_s)

    def _emit_rate(self, message: Measurement, last_s: float) -> None:
        rates = message.samples.get(self._rate, ())
        if rates:
            self._rate_valid = float(math.isfinite(rates[-1]))
            self._sink.emit("bpm", rates, self._times(len(rates), last_s))

    def _emit_quality(self, time_s: float) -> None:
        quality = (self._rate_valid, self._fit.tension)
        if quality != self._quality or time_s - self._quality_s >= QUALITY_PERIOD_S:
            self._quality, self._quality_s = quality, time_s
            self._sink.emit("quality", [quality], [time_s])

    def _lost(self, count: int) -> None:
        # nothing is dropped: `lost` counts them below
        self.log.warning("samples were lost", samples=count, estimated=True)
        for data_name in ("force", "bpm"):
            self._sink.lost(data_name, count)

    def _times(self, count: int, last_s: float) -> list[float]:
        return [last_s - ahead * self._period_s for ahead in range(count - 1, -1, -1)]
