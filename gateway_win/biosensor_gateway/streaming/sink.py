"""Maps the times of a device's samples to LSL, and pushes them."""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from biosensor_common.clocks import MonotonicStamps
from biosensor_common.device_clock import ClockState, DeviceClock
from biosensor_common.naming import source_id
from biosensor_common.quantities import ChannelRole
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo, SensorSpec
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.events.announcer import Announcer, DeviceEvents
from biosensor_gateway.streaming.outlets import MAX_STAMP_ERROR_S, DeviceOutlets, differences
from biosensor_gateway.streaming.silence import Silence, StreamWatch
from biosensor_gateway.streaming.stages import Constants, PauseGate, Plausibility
from biosensor_gateway.system.clock import LSL_CLOCK, Clock
from biosensor_gateway.system.device_log import DeviceLog, Once

DEVICE_RESTARTED = "device_restarted"
"""Cause of a re-anchor that a driver asks for."""
TOGETHER_S = 0.1
"""What had waited comes within such a time."""
WAITED_S = 0.5
"""Delays of a link that is well are shorter."""
JUMPS_SAID, JUMPS_SAID_WITHIN_S = 3, 60.0
"""So many are said in so many seconds."""


class DeviceSink:
    """Takes the data of one device, over all its connections.

    It has the device's clock, outlets and counters. A driver reports packets with
    :meth:`observe`, then passes their samples with times on the device's own clock. Drivers import
    it for their annotations only: help and settings import them, and must work without numpy and
    liblsl.

    Attributes
    ----------
    dropped_bytes
        Bytes without a valid message; drivers add to it.
    """

    def __init__(
        self, identity: DeviceIdentity, spec: SensorSpec, clock: Clock = LSL_CLOCK
    ) -> None:
        self.identity = identity
        self.clock = clock  # The LSL clock.
        self.watch = StreamWatch(clock)  # Finds the streams that are expected and silent.
        self.spec = spec  # What the device emits.
        # Notified of the device's events, if there is one.
        self.observer: DeviceEvents | None = None
        # Called with what was sent: data name, samples in the units of the declaration (none of
        # text), stamps. Must neither raise nor wait.
        self.tap: Callable[[str, ArrayLike, Sequence[float]], None] | None = None
        # Data names of the streams that the settings switch off.
        self.silent: frozenset[str] = frozenset()
        self.charge = Charge(spec)  # State of its battery, as far as it is known.
        # Returns how long packets may recently have waited for this computer, in seconds.
        self.own_delay: Callable[[], float] = lambda: 0.0
        # Labels of channels that this device does not send, by data name: their values
        # are NaN, and nothing of them is missing.
        self.lacking: dict[str, Sequence[str]] = {}
        self._clock = DeviceClock()
        self._outlets = DeviceOutlets(identity, spec, clock)
        self._stamps: defaultdict[str, MonotonicStamps] = defaultdict(MonotonicStamps)
        self._log = DeviceLog("biosensor_gateway.sink", identity)
        self._jumps = JumpReports(clock, self._say_jumps)
        self._arrivals = Arrivals(self._tell_late)
        self._latest_s: defaultdict[str, float] = defaultdict(float)
        self._is_new = Once()
        self.gate = PauseGate()
        self._gaps = Gaps(clock)
        self.plausibility = Plausibility(spec, self._log)  # Suppresses impossible values.
        self._constants = Constants(spec)
        # info, told_rates: what the device reports of itself, and nominal rates in Hz that it sets;
        # empty at first.
        self.info = DeviceInfo()
        self.told_rates: Mapping[str, float] = {}
        self.dropped_bytes = self._told_bytes = 0
        self.refusals = Refusals(clock=clock)  # Counts the device's bytes that are not samples.

    @property
    def refused(self) -> dict[str, Refusals]:
        """Data that were left out or changed, by source_id."""
        return self._outlets.refusals

    @property
    def off(self) -> set[str]:
        """The source_ids of streams that the settings or the device's model do not have."""
        return {source_id(self.identity, data_name) for data_name in self.silent}

    @property
    def clock_state(self) -> ClockState:
        """Offset, drift and re-anchors of the device's clock."""
        return self._clock.state

    @property
    def counters(self) -> dict[str, Counters]:
        """Counters of all streams by source_id."""
        return self._outlets.counters

    @property
    def nominal_rates(self) -> dict[str, float]:
        """Nominal rates in Hz of all streams by source_id, 0 of irregular ones."""
        return self._outlets.rates

    @property
    def is_open(self) -> bool:
        """Whether the outlets exist."""
        return bool(self._outlets.counters)

    def follow(self, announcer: Announcer) -> DeviceEvents:
        """Announce the device's events from now on."""
        self.observer = events = DeviceEvents(
            self.identity, self.spec, self.clock, announcer, is_paused=self.is_paused
        )
        announcer.watch(events.tick)
        return events

    def expect(self, info: DeviceInfo, rates: Mapping[str, float]) -> None:
        """Create the outlets ahead of the connection; see :meth:`DeviceOutlets.expect`."""
        if self._outlets.expect(info, rates):
            self.info, self.told_rates = info, rates

    def open(self, info: DeviceInfo, rates: Mapping[str, float]) -> None:
        """Create the outlets, at the first connection; see :meth:`DeviceOutlets.open`."""
        rebuilt = self._outlets.open(info, rates)
        self._constants.restart()
        if self.observer is not None:
            changes = {f"{name}.rate_hz": rate for name, rate in rebuilt.items()}
            self.observer.connected(info, {**changes, **differences(self.info, info)})
        self.info, self.told_rates = info, rates

    def close(self) -> None:
        """Destroy the outlets."""
        self._jumps.finish()
        self._outlets.close()

    def release(self) -> None:
        """Push states that wait for a receiver; call it about once per second."""
        self._outlets.release()
        self._jumps.release()
        self._constants.look(self.clock())
        if garbled := self.dropped_bytes - self._told_bytes:
            self._told_bytes += garbled
            self.refusals.refuse(Refusal.GARBLED, garbled)

    @property
    def is_paused(self) -> bool:
        """Whether the device's samples are suppressed."""
        return self.gate.is_on

    def pause(self, since: float | None = None) -> None:
        """Suppress all samples from now on, including queued ones; the device stays connected."""
        if not self.is_paused:
            self.gate.begin(self.clock(), since)
            self._outlets.withhold_waiting()
            if self.observer is not None:
                self.observer.paused()

    def resume(self) -> None:
        """Send samples measured from now on; see :class:`PauseGate`."""
        if self.is_paused:
            self.gate.end(self.clock())
            if self.observer is not None:
                self.observer.resumed(self.gate.send_from)

    def heard(self, *data_names: str) -> None:
        """Note valid data from the device, about these streams or in general.

        Emitted samples are noted automatically; call this only for data without samples.
        """
        self.watch.heard(*data_names)

    def remark(self, about: str, text: str = "") -> None:
        """Show a problem with the data to the user; an empty text clears it.

        It stays in the device's status until cleared or until the next connection.
        """
        self.watch.remark(about, text)

    def excuse(self, *data_names: str) -> None:
        """Stop monitoring these streams until data arrive again, for a known reason."""
        self.watch.excuse(data_names)

    @property
    def is_waiting(self) -> bool:
        """Whether a stream was restarted and no data has arrived since."""
        return self.watch.is_waiting

    def tell_silent(self, silence: Silence) -> None:
        """Notify the observer of streams that are expected and silent."""
        if self.observer is not None:
            self.observer.fell_silent(silence)

    def tell_came_back(self, streams: frozenset[str]) -> None:
        """Notify the observer of streams that send again."""
        if self.observer is not None:
            self.observer.came_back(streams)

    def observe(self, device_s: float, arrival_s: float, kind: str = "") -> None:
        """Add the device time of a packet's last sample and its LSL time of arrival.

        Give `kind` if packets of that kind keep their order; see :meth:`DeviceClock.observe`.
        """
        jump = self._clock.observe(device_s, arrival_s, kind, self.own_delay())
        if jump is not None:
            self._jumps.note(jump.reason.value, jump.size_s)
        (measured_s,) = self._clock.all_to_lsl([device_s])
        self._arrivals.observe(arrival_s, arrival_s - measured_s)

    def restart_clock(self) -> None:
        """Restart the mapping of device times, because the device restarted its clock.

        Samples with device times can only be emitted after the next observation.
        """
        reanchors = self._clock.state.reanchors
        self._clock.restart()
        if self._clock.state.reanchors > reanchors:
            self._jumps.note(DEVICE_RESTARTED, None)

    def emit(self, data_name: str, samples: ArrayLike, device_times: Sequence[float]) -> None:
        """Push samples.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
            In the units of the declaration.
        device_times : sequence of float, length n_samples
            Device clock of each sample in seconds.
        """
        self.emit_at(data_name, samples, self._clock.all_to_lsl(device_times))

    def emit_at(self, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]) -> None:
        """Push samples with LSL times, for data without device timestamps.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
            In the units of the declaration.
        lsl_times : sequence of float, length n_samples
            Best estimate of the LSL time of each sample, in seconds.
        """
        if len(lsl_times):
            self.watch.heard(data_name)
        samples, stamps = self._sendable(data_name, samples, lsl_times)
        outlet = self._outlets[data_name]
        samples, stamps = self.plausibility.believed(
            data_name, samples, stamps, outlet.counters, outlet.refusals
        )
        if len(lsl_times) and not len(stamps):
            return  # nothing is dropped: `_sendable` has counted what a pause withholds
        if max(stamps, default=0.0) < self.clock() + MAX_STAMP_ERROR_S:
            # One from the future is refused; guarded, it would push all later ones there, too.
            stamps = self._stamps[data_name].apply(stamps)
        refusal = outlet.push(samples, stamps)
        if refusal is None:
            self.charge.sampled(data_name, samples, stamps)
            if len(stamps):
                self._constants.note(data_name, samples, stamps, outlet.refusals)
            self._tell_sampled(data_name, samples, stamps)
        elif self._is_new(data_name, refusal):
            # nothing is dropped: the outlet reports it
            self._log.error("samples were refused", data=data_name, cause=refusal)

    def emit_on_arrival(self, data_name: str, value: float, arrival_s: float) -> None:
        """Push one value of a one-channel stream, sent at once and without a timestamp.

        If it arrived with stored packets, it gets the time of the packet before it; samples that
        are still stamped late are reported.
        """
        waited_s = self._arrivals.waited_s(arrival_s)
        self.emit_at(data_name, [value], [arrival_s - waited_s])
        if not waited_s:
            self.note_arrival(data_name, arrival_s)

    def note_arrival(self, data_name: str, arrival_s: float, count: int = 1) -> None:
        """Note samples with times based on an arrival, which are reported if it turns out late."""
        self._arrivals.note(data_name, arrival_s, count)

    def emit_value(self, data_name: str, value: float | None, device_s: float) -> None:
        """Push one value of a one-channel stream; None is "no value", which sends nothing."""
        if value is not None:
            self.emit(data_name, [value], [device_s])

    def emit_text(self, data_name: str, text: str, device_s: float) -> None:
        """Push one string sample with a time on the device's clock."""
        self.heard(data_name)
        _, stamps = self._sendable(data_name, [0.0], [self._clock.to_lsl(device_s)])
        for stamp in self._stamps[data_name].apply(stamps):
            self._outlets[data_name].push_text(text, stamp)
            self._tell_sampled(data_name, (), [stamp])

    def lost(self, data_name: str, count: int) -> None:
        """Count samples that the device measured but that never arrived.

        Samples that a pause would have suppressed are not lost: of a gap that was partly paused,
        the same part is not counted.
        """
        begin, end = self._gaps.widest(data_name)
        missed = count - round(count * self.gate.share(begin, end))
        self._outlets[data_name].counters.lost += missed
        if missed and self.observer is not None:
            self.observer.lost(data_name, missed, begin)

    def left_out(self, count: int, why: str) -> None:
        """Count samples that arrived but are not emitted, such as copies; *why* is a clause."""
        self.refusals.refuse(Refusal.LEFT_OUT, count, why=why)

    def _sendable(
        self, data_name: str, samples: ArrayLike, times: Sequence[float]
    ) -> tuple[ArrayLike, Sequence[float]]:
        """Remove and count samples that a pause suppresses."""
        if not len(times):
            return samples, times
        self._gaps.note(data_name, times)
        may_send = self.gate.may_send(times)
        rows = np.asarray(samples)
        # Samples that do not fit their times are refused; there is no telling which is which.
        if all(may_send) or rows.shape[:1] != (len(times),):
            return samples, times
        self._outlets[data_name].withhold(may_send.count(False))
        # nothing is dropped: `withhold` has counted it
        return rows[may_send], [time for time, sent in zip(times, may_send, strict=True) if sent]

    def _tell_late(self, data_name: str, count: int, seconds: float) -> None:
        self._latest_s[data_name] = latest_s = max(seconds, self._latest_s[data_name])
        self._outlets[data_name].refusals.refuse(Refusal.LATE, count, seconds=latest_s)

    def _say_jumps(self, jumps: Jumps) -> None:
        if jumps.cause != DEVICE_RESTARTED or jumps.times > 1:
            self._log.warning(  # nothing is dropped: stamps are told again
                "the device's clock jumped; its timestamps were re-anchored",
                cause=jumps.cause,
                **({} if jumps.seconds is None else {"seconds": round(jumps.seconds, 3)}),
                **({} if jumps.times == 1 else {"times": jumps.times}),
            )
        if self.observer is not None:
            self.observer.reanchored(*jumps)

    def _tell_sampled(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        if not len(stamps):
            return  # nothing is dropped: there is nothing
        if self.tap is not None:
            self.tap(data_name, samples, stamps)
        if self.observer is not None:
            self.observer.sampled(data_name, samples, stamps)


class Charge:
    """Monitors the first channel of one device that has the role of state of charge."""

    def __init__(self, spec: SensorSpec) -> None:
        first = next(spec.channels_of(ChannelRole.STATE_OF_CHARGE), ("", 0, ""))
        self._data_name, self._index, _ = first
        self.percent: float | None = None  # Newest value; None before the first.

    def sampled(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        """Process samples of any stream of the device; NaN is ignored.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
        stamps : sequence of float, length n_samples
        """
        if data_name != self._data_name:
            return  # nothing is dropped: another stream's
        values = np.asarray(samples, np.float64).reshape(len(stamps), -1)[:, self._index]
        known = values[np.isfinite(values)]
        if known.size:
            self.percent = float(known[-1])


class Gaps:
    """The time of the newest sample of each stream of one device, and of the one before.

    Parameters
    ----------
    clock
        The LSL clock; later times are limited to it.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._newest: dict[str, float] = {}
        self._steps: dict[str, tuple[float, float]] = {}

    def note(self, data_name: str, times: Sequence[float]) -> None:
        """Note samples at these LSL times, at least one."""
        newest = self._newest.get(data_name)
        if newest is not None:
            self._steps[data_name] = newest, times[0]
        self._newest[data_name] = min(max(times), self._clock())

    def widest(self, data_name: str) -> tuple[float, float]:
        """Return the period in which samples that are counted as lost now are missing.

        Some drivers count them before they emit the samples after the gap, some after: so it is
        the last step, or from the newest sample to now.
        """
        now = self._clock()
        newest = self._newest.get(data_name, now)
        spans = (newest, now), self._steps.get(data_name, (newest, newest))
        return max(spans, key=lambda span: span[1] - span[0])


class Arrivals:
    """Finds samples that are stamped by their arrival although they had been delayed.

    On a link that keeps its order, packets with device timestamps show the delay of packets around
    them. Without these, the delay follows from the number of samples of a stream that arrive
    together; a single delayed sample is not found, and is late by less than one period.

    Parameters
    ----------
    tell
        Called with the data name, the number of samples, and their largest delay in seconds.
    """

    def __init__(self, tell: Callable[[str, int, float], None]) -> None:
        self._tell = tell
        self._late_s, self._observed_s = 0.0, -math.inf
        self._newest_s: float | None = None
        self._before_s = 0.0
        self._noted: dict[str, tuple[float, int]] = {}

    def observe(self, arrival_s: float, late_s: float) -> None:
        """Process a packet with a device timestamp."""
        self._follow(arrival_s)
        self._late_s, self._observed_s = late_s if late_s > WAITED_S else 0.0, arrival_s
        noted, self._noted = self._noted, {}
        for data_name, (noted_s, count) in noted.items():
            if count and self._late_s and arrival_s - noted_s <= TOGETHER_S:
                self._tell(data_name, count, late_s)

    def waited_s(self, arrival_s: float) -> float:
        """Return the delay of data that arrive now, in seconds; 0 if none or unknown."""
        return self._late_s if arrival_s - self._observed_s <= TOGETHER_S else 0.0

    def note(self, data_name: str, arrival_s: float, count: int) -> None:
        """Note samples that are stamped by their arrival."""
        self._follow(arrival_s)
        if waited_s := self.waited_s(arrival_s):
            self._tell(data_name, count, waited_s)
            return  # nothing is dropped: it was emitted, and is reported
        noted_s, earlier = self._noted.get(data_name, (-math.inf, 0))
        if arrival_s - noted_s <= TOGETHER_S:
            # They were measured since something came before, the last one up to a period ago.
            self._tell(data_name, earlier + count, arrival_s - self._before_s)
            count = 0
        self._noted[data_name] = arrival_s, count

    def _follow(self, arrival_s: float) -> None:
        if self._newest_s is None or arrival_s - self._newest_s > TOGETHER_S:
            self._before_s = arrival_s if self._newest_s is None else self._newest_s
        self._newest_s = arrival_s


class Jumps(NamedTuple):
    """One jump, or several that are reported together."""

    cause: str  # Cause of the last one.
    seconds: float | None  # Their sum; None if the size of one is unknown.
    times: int = 1  # Their number.


class JumpReports:
    """Reports at most three jumps per minute, so that neither log nor events are flooded.

    Parameters
    ----------
    say
        Called with each jump, or with several together.
    """

    def __init__(self, clock: Clock, say: Callable[[Jumps], None]) -> None:
        self._clock = clock
        self._say = say
        # nothing is dropped: these are times
        self._said_s: deque[float] = deque(maxlen=JUMPS_SAID)
        self._gathered: Jumps | None = None

    def note(self, cause: str, seconds: float | None) -> None:
        """Report a jump now, or collect it."""
        self._gathered = _together(self._gathered, Jumps(cause, seconds))
        self.release()

    def release(self) -> None:
        """Report collected jumps if enough time has passed; call it about once per second."""
        if self._gathered is None:
            return  # nothing is dropped: there is nothing to say
        now = self._clock()
        if len(self._said_s) < JUMPS_SAID or now - self._said_s[0] >= JUMPS_SAID_WITHIN_S:
            self._said_s.append(now)
            self.finish()

    def finish(self) -> None:
        """Report collected jumps at once."""
        gathered, self._gathered = self._gathered, None
        if gathered is not None:
            # nothing is dropped: it tells of times
            self._say(gathered)


def _together(before: Jumps | None, jump: Jumps) -> Jumps:
    if before is None:
        return jump
    seconds = None
    if before.seconds is not None and jump.seconds is not None:
        seconds = before.seconds + jump.seconds
    return Jumps(jump.cause, seconds, before.times + 1)
