"""Maps the times of a device's samples to LSL and pushes them."""

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
from biosensor_gateway.streaming.stages import PauseGate, Plausibility
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
    """One device's clock, outlets and counters; they outlive its connections.

    A driver reports packets with :meth:`observe`, then hands over their samples
    with times on the device's own clock.

    Attributes
    ----------
    spec
        What the device emits.
    observer
        Is told what happens; None for nobody.
    tap
        Is given what was sent: data name, samples in the units of the declaration (none of
        text), stamps. Must neither raise nor wait. None for nobody.
    silent
        Data names of the streams that the settings switch off.
    watch
        Knows which streams are due and do not come.
    clock
        The LSL time that everything of the device goes by.
    info, told_rates
        What the device says of itself, and nominal rates in Hz that it sets; empty at first.
    charge
        What is known of its battery.
    plausibility
        Keeps back what cannot be.
    refusals
        What of the device's bytes is no sample.
    own_delay
        Tells for how many seconds a packet may have had to wait for this computer lately.
    lacking
        Labels of channels that this model of the device does not have, by data name.
    """

    def __init__(
        self, identity: DeviceIdentity, spec: SensorSpec, clock: Clock = LSL_CLOCK
    ) -> None:
        self.identity = identity
        self.clock = clock
        self.watch = StreamWatch(clock)
        self.spec = spec
        self.observer: DeviceEvents | None = None
        self.tap: Callable[[str, ArrayLike, Sequence[float]], None] | None = None
        self.silent: frozenset[str] = frozenset()
        self.charge = Charge(spec)
        self.own_delay: Callable[[], float] = lambda: 0.0
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
        self.plausibility = Plausibility(spec, self._log)
        self.info = DeviceInfo()
        self.told_rates: Mapping[str, float] = {}
        self.dropped_bytes = self._told_bytes = 0
        self.refusals = Refusals(clock=clock)

    @property
    def refused(self) -> dict[str, Refusals]:
        """What of each stream was not passed on as it came, by source_id."""
        return self._outlets.refusals

    @property
    def off(self) -> set[str]:
        """Return the streams that the settings or the model have none of, by source_id."""
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
        """Announce what happens to the device from now on."""
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
        if self.observer is not None:
            changes = {f"{name}.rate_hz": rate for name, rate in rebuilt.items()}
            self.observer.connected(info, {**changes, **differences(self.info, info)})
        self.info, self.told_rates = info, rates

    def close(self) -> None:
        """Destroy the outlets."""
        self._jumps.finish()
        self._outlets.close()

    def release(self) -> None:
        """Push states that wait for a receiver; to be called once a second or so."""
        self._outlets.release()
        self._jumps.release()
        if garbled := self.dropped_bytes - self._told_bytes:
            self._told_bytes += garbled
            self.refusals.refuse(Refusal.GARBLED, garbled)

    @property
    def is_paused(self) -> bool:
        """Whether the device's samples are withheld."""
        return self.gate.is_on

    def pause(self, since: float | None = None) -> None:
        """Send nothing from now on, also not what is still in work; the device stays connected."""
        if not self.is_paused:
            self.gate.begin(self.clock(), since)
            self._outlets.withhold_waiting()
            if self.observer is not None:
                self.observer.paused()

    def resume(self) -> None:
        """Send again what is measured from now on; see :class:`PauseGate`."""
        if self.is_paused:
            self.gate.end(self.clock())
            if self.observer is not None:
                self.observer.resumed(self.gate.send_from)

    def heard(self, *data_names: str) -> None:
        """Note that the device said something valid; see :meth:`StreamWatch.heard`.

        Samples are noted by themselves, so only what comes without a value has to be told.
        """
        self.watch.heard(*data_names)

    def remark(self, about: str, text: str = "") -> None:
        """Have a person see what is wrong with what comes; see :meth:`StreamWatch.remark`."""
        self.watch.remark(about, text)

    def excuse(self, *data_names: str) -> None:
        """Expect nothing of these streams until they are heard again: there is a reason."""
        self.watch.excuse(data_names)

    @property
    def is_waiting(self) -> bool:
        """Whether a stream was enabled again, and has not been heard since."""
        return self.watch.is_waiting

    def tell_silent(self, silence: Silence) -> None:
        """Tell the observer of streams that are due and do not come."""
        if self.observer is not None:
            self.observer.fell_silent(silence)

    def tell_came_back(self, streams: frozenset[str]) -> None:
        """Tell the observer of streams that had fallen silent."""
        if self.observer is not None:
            self.observer.came_back(streams)

    def observe(self, device_s: float, arrival_s: float, kind: str = "") -> None:
        """Take in the device time of a packet's last sample and its LSL time of arrival.

        If packets of a kind keep their order, its name helps; see :meth:`DeviceClock.observe`.
        """
        jump = self._clock.observe(device_s, arrival_s, kind, self.own_delay())
        if jump is not None:
            self._jumps.note(jump.reason.value, jump.size_s)
        (measured_s,) = self._clock.all_to_lsl([device_s])
        self._arrivals.observe(arrival_s, arrival_s - measured_s)

    def restart_clock(self) -> None:
        """Map device times again from the next observation on: the device counts again.

        Nothing can be emitted with device times before that observation.
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
        """Push samples that the device does not stamp, with times on the LSL clock already.

        Parameters
        ----------
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
            In the units of the declaration.
        lsl_times : sequence of float, length n_samples
            LSL clock at each sample, as near as can be told, in seconds.
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
            self._tell_sampled(data_name, samples, stamps)
        elif self._is_new(data_name, refusal):
            # nothing is dropped: the outlet reports it
            self._log.error("samples were refused", data=data_name, cause=refusal)

    def emit_on_arrival(self, data_name: str, value: float, arrival_s: float) -> None:
        """Push one value of a one-channel stream that the device does not stamp and sends at once.

        Where it came with packets that had waited, it is as old as the one before it; what is
        stamped late all the same is reported.
        """
        waited_s = self._arrivals.waited_s(arrival_s)
        self.emit_at(data_name, [value], [arrival_s - waited_s])
        if not waited_s:
            self.note_arrival(data_name, arrival_s)

    def note_arrival(self, data_name: str, arrival_s: float, count: int = 1) -> None:
        """Have samples reported that were placed by an arrival, should it turn out late."""
        self._arrivals.note(data_name, arrival_s, count)

    def emit_value(self, data_name: str, value: float | None, device_s: float) -> None:
        """Push one value of a one-channel stream; None is "no value", which sends nothing."""
        if value is not None:
            self.emit(data_name, [value], [device_s])

    def emit_text(self, data_name: str, text: str, device_s: float) -> None:
        """Push one string sample measured at a time of the device's clock."""
        self.heard(data_name)
        _, stamps = self._sendable(data_name, [0.0], [self._clock.to_lsl(device_s)])
        for stamp in self._stamps[data_name].apply(stamps):
            self._outlets[data_name].push_text(text, stamp)
            self._tell_sampled(data_name, (), [stamp])

    def lost(self, data_name: str, count: int) -> None:
        """Count samples that the device measured and that never arrived.

        Those that a pause would have withheld are none: of a gap that was partly paused,
        the same part is not counted.
        """
        begin, end = self._gaps.widest(data_name)
        missed = count - round(count * self.gate.share(begin, end))
        self._outlets[data_name].counters.lost += missed
        if missed and self.observer is not None:
            self.observer.lost(data_name, missed, begin)

    def left_out(self, count: int, why: str) -> None:
        """Count samples that arrived and are not emitted, such as copies; *why* is a clause."""
        self.refusals.refuse(Refusal.LEFT_OUT, count, why=why)

    def _sendable(
        self, data_name: str, samples: ArrayLike, times: Sequence[float]
    ) -> tuple[ArrayLike, Sequence[float]]:
        """Take out, and count, what a pause withholds."""
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
                "the device's clock jumped; its stamps are re-anchored",
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
    """Follows the first channel of one device that has the role of state of charge.

    Attributes
    ----------
    percent
        Newest value; None before the first.
    """

    def __init__(self, spec: SensorSpec) -> None:
        first = next(spec.channels_of(ChannelRole.STATE_OF_CHARGE), ("", 0, ""))
        self._data_name, self._index, _ = first
        self.percent: float | None = None

    def sampled(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        """Take in samples of any stream of the device; NaN says nothing.

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
    """The newest sample of each stream of one device, and the step to it from the one before.

    Parameters
    ----------
    clock
        The LSL time; no sample is taken for newer.
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
        """Return where samples that are counted as lost now are missing.

        Some drivers count them before they emit what follows the gap, some after: so it is
        the last step, or from the newest sample to now.
        """
        now = self._clock()
        newest = self._newest.get(data_name, now)
        spans = (newest, now), self._steps.get(data_name, (newest, newest))
        return max(spans, key=lambda span: span[1] - span[0])


class Arrivals:
    """Finds samples that are stamped by their arrival although they had waited.

    On a link that keeps its order, packets that the device stamps tell how late those around them
    are. Without any, samples of one stream that arrive together are as late as they are many; one
    that has waited alone is not found, and is late by less than the time between two.

    Parameters
    ----------
    tell
        Is given the data name, how many there are, and by up to how many seconds they are late.
    """

    def __init__(self, tell: Callable[[str, int, float], None]) -> None:
        self._tell = tell
        self._late_s, self._observed_s = 0.0, -math.inf
        self._newest_s: float | None = None
        self._before_s = 0.0
        self._noted: dict[str, tuple[float, int]] = {}

    def observe(self, arrival_s: float, late_s: float) -> None:
        """Take in a packet that the device stamped."""
        self._follow(arrival_s)
        self._late_s, self._observed_s = late_s if late_s > WAITED_S else 0.0, arrival_s
        noted, self._noted = self._noted, {}
        for data_name, (noted_s, count) in noted.items():
            if count and self._late_s and arrival_s - noted_s <= TOGETHER_S:
                self._tell(data_name, count, late_s)

    def waited_s(self, arrival_s: float) -> float:
        """Return for how long what arrives now has waited, 0 if it has not or nobody knows."""
        return self._late_s if arrival_s - self._observed_s <= TOGETHER_S else 0.0

    def note(self, data_name: str, arrival_s: float, count: int) -> None:
        """Note samples that an arrival has placed."""
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
    """One jump, or several that are said together.

    Attributes
    ----------
    cause
        Of the last one.
    seconds
        By which they moved the mapping in all; None if that is not known of each.
    times
        How many they are.
    """

    cause: str
    seconds: float | None
    times: int = 1


class JumpReports:
    """Hands jumps on, three a minute at most, so that neither log nor events are flooded.

    Parameters
    ----------
    say
        Is told of each jump, or of several at once.
    """

    def __init__(self, clock: Clock, say: Callable[[Jumps], None]) -> None:
        self._clock = clock
        self._say = say
        # nothing is dropped: these are times
        self._said_s: deque[float] = deque(maxlen=JUMPS_SAID)
        self._gathered: Jumps | None = None

    def note(self, cause: str, seconds: float | None) -> None:
        """Say a jump now, or gather it."""
        self._gathered = _together(self._gathered, Jumps(cause, seconds))
        self.release()

    def release(self) -> None:
        """Say what was gathered, if it may be said by now; to be called once a second or so."""
        if self._gathered is None:
            return  # nothing is dropped: there is nothing to say
        now = self._clock()
        if len(self._said_s) < JUMPS_SAID or now - self._said_s[0] >= JUMPS_SAID_WITHIN_S:
            self._said_s.append(now)
            self.finish()

    def finish(self) -> None:
        """Say what was gathered, whenever it was."""
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
