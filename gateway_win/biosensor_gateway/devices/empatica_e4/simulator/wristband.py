"""One wristband as seen by the server: advertising, connected, lost or off."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count
from math import ceil, inf

import numpy as np

from biosensor_gateway.devices.empatica_e4.simulator.wire import (
    ACC,
    BATTERY,
    BVP,
    COUNTS_PER_G,
    GSR,
    HR,
    IBI,
    TAG,
    TEMPERATURE,
    Packet,
    Sample,
    Stamps,
    Stream,
    WallClock,
    as_sent,
)
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.simulation.virtual_device import Specimen
from biosensor_gateway.simulation.wearer import PULSE_TRANSIT_S, Floats, Wearer
from biosensor_gateway.simulation.world import Oscillator

Rows = list[tuple[float, ...]]

_BVP_SCALE = 120.0
_AMBIENT_C = 24.5
# Value sent while the electrodes have no skin contact.
_OPEN = 0.0


class Signals:
    """The sensors of one wristband; all times are the wearer's [s]."""

    def __init__(self, wearer: Wearer) -> None:
        self.is_worn = True
        self.battery = 0.82  # Battery level, 0 to 1.
        self._wearer = wearer

    def read(self, stream: Stream, t: Floats) -> Rows:
        """Return the values of a regular stream at given times, rounded as in the format."""
        if stream is ACC:
            counts = np.rint(self._wearer.acceleration_g(t) * COUNTS_PER_G)
            return [tuple(row) for row in np.clip(counts, -128, 127).tolist()]
        return [(as_sent(value),) for value in self._read_one(stream, t).tolist()]

    def beats_between(self, begin_s: float, end_s: float) -> Sequence[float]:
        """Return the times of pulse waves at the wrist; none if it is not worn."""
        if not self.is_worn:
            return []
        peaks = self._wearer.beats_between(begin_s - PULSE_TRANSIT_S, end_s - PULSE_TRANSIT_S)
        times: list[float] = (peaks + PULSE_TRANSIT_S).tolist()
        return times

    def _read_one(self, stream: Stream, t: Floats) -> Floats:
        if stream is BVP:
            pulse = self._wearer.pulse(t) if self.is_worn else self._wearer.noise(t, 0.02, "light")
            return _BVP_SCALE * pulse
        if stream is GSR:
            return self._wearer.skin_conductance_us(t) if self.is_worn else np.full(t.shape, _OPEN)
        assert stream is TEMPERATURE
        # The sensor has a resolution of 0.02 degrees.
        celsius = self._wearer.skin_temperature_c(t) if self.is_worn else _ambient(t)
        return np.rint(celsius * 50) / 50


def _ambient(t: Floats) -> Floats:
    return np.full(t.shape, _AMBIENT_C)


_BLOCK_S = 1 / 16
_BEAT_TICKS_HZ = 64


@dataclass(frozen=True, slots=True)
class Timing:
    """When samples are sent."""

    burst: int = 6  # Number of GSR and temperature samples sent together.
    beat_delay_s: float = 5.6  # Delay of a beat's HR and IBI.
    battery_interval_s: float = 10.0
    jitter_s: float = 0.0  # Maximum radio delay of a packet.


class RadioLink:
    """One radio link; the wristband streams from its start on.

    Parameters
    ----------
    begin_s
        LSL time at which the wearer's time is 0.
    arrive
        Called with each packet when it arrives at the server.
    """

    def __init__(
        self,
        signals: Signals,
        oscillator: Oscillator,
        begin_s: float,
        timing: Timing,
        rng: np.random.Generator,
        arrive: Callable[[Packet], None],
    ) -> None:
        self._signals = signals
        self._oscillator = oscillator
        self._begin_s = begin_s
        self._timing = timing
        self._rng = rng
        self._arrive = arrive
        self._origin_s = oscillator.now()
        self._per_packet = {BVP: 1, ACC: 1, GSR: timing.burst, TEMPERATURE: timing.burst}
        self._gathered: dict[Stream, list[Sample]] = {stream: [] for stream in self._per_packet}
        self._last_arrival_s: dict[str, float] = {}
        self._beat_tick: int | None = None
        self._battery_s = 0.0
        self._order = count()
        self._on_its_way: list[Packet] = []
        self._task = asyncio.get_running_loop().create_task(self._run())

    def end(self) -> None:
        """Stop measuring and sending; packets in transit do not arrive."""
        self._task.cancel()

    def tag(self) -> None:
        """Send a tag, because the button was pressed."""
        now = self._oscillator.clock()
        self._dispatch((Sample(TAG, now, self._oscillator.at(now) - self._origin_s, ()),), 0.0)

    async def _run(self) -> None:
        for block in count():
            self._measure(block * _BLOCK_S, (block + 1) * _BLOCK_S)
            end_s = self._true_time((block + 1) * _BLOCK_S)
            while self._on_its_way and self._on_its_way[0].arrives_s <= end_s:
                # An earlier packet, such as a tag, may be added during the wait.
                await asyncio.sleep(
                    max(0.0, self._on_its_way[0].arrives_s - self._oscillator.clock())
                )
                self._arrive(heappop(self._on_its_way))
            await asyncio.sleep(max(0.0, end_s - self._oscillator.clock()))

    def _measure(self, from_s: float, to_s: float) -> None:
        """Measure a block of device time since the start of the link, shortly in advance."""
        for stream in self._per_packet:
            self._measure_regular(stream, from_s, to_s)
        self._measure_beats(from_s, to_s)
        if from_s <= self._battery_s < to_s:
            self._send_one(BATTERY, self._battery_s, as_sent(self._signals.battery))
            self._battery_s += self._timing.battery_interval_s

    def _measure_regular(self, stream: Stream, from_s: float, to_s: float) -> None:
        rate_hz = stream.rate_hz or inf
        numbers = range(ceil(from_s * rate_hz), ceil(to_s * rate_hz))
        if not numbers:
            return
        after = [number / rate_hz for number in numbers]
        times = [self._true_time(after_s) for after_s in after]
        rows = self._signals.read(stream, np.array(times) - self._begin_s)
        gathered = self._gathered[stream]
        for time_s, after_s, row in zip(times, after, rows, strict=True):
            gathered.append(Sample(stream, time_s, after_s, row))
            if len(gathered) == self._per_packet[stream]:
                self._dispatch(tuple(gathered), 0.0)
                gathered.clear()

    def _measure_beats(self, from_s: float, to_s: float) -> None:
        begin, end = self._true_time(from_s), self._true_time(to_s)
        if not self._signals.is_worn:
            self._beat_tick = None
        for beat_s in self._signals.beats_between(begin - self._begin_s, end - self._begin_s):
            after_s = self._oscillator.at(beat_s + self._begin_s) - self._origin_s
            tick, before = round(after_s * _BEAT_TICKS_HZ), self._beat_tick
            self._beat_tick = tick
            if before is not None:
                self._send_beat(tick / _BEAT_TICKS_HZ, (tick - before) / _BEAT_TICKS_HZ)

    def _send_beat(self, after_s: float, interval_s: float) -> None:
        measured_s = self._true_time(after_s)
        rate = Sample(HR, measured_s, after_s, (as_sent(60 / interval_s),))
        interval = Sample(IBI, measured_s, after_s, (as_sent(interval_s),))
        self._dispatch((rate, interval), self._timing.beat_delay_s)

    def _send_one(self, stream: Stream, after_s: float, *values: float) -> None:
        self._dispatch((Sample(stream, self._true_time(after_s), after_s, values),), 0.0)

    def _dispatch(self, samples: tuple[Sample, ...], delay_s: float) -> None:
        """Send samples when the last one is measured; a stream's packets stay in order."""
        name = samples[0].stream.word
        due_s = samples[-1].measured_s + delay_s + self._rng.uniform(0, self._timing.jitter_s)
        arrives_s = max(due_s, self._last_arrival_s.get(name, due_s))
        self._last_arrival_s[name] = arrives_s
        heappush(self._on_its_way, Packet(arrives_s, next(self._order), samples))

    def _true_time(self, after_s: float) -> float:
        return self._oscillator.true_time(self._origin_s + after_s)


Deliver = Callable[["Wristband", Packet], None]


class Wristband:
    """A wristband.

    Parameters
    ----------
    device_id
        Six hexadecimal digits.
    specimen
        Its wearer and the properties of its oscillator.
    is_allowed
        Whether it is registered to the owner of the server's key.
    truth
        Truth of the data sent by the server.
    deliver
        Called with packets that arrive, and with those lost while out of range.

    Attributes
    ----------
    stamps
        Timestamps of the current or last radio link.
    """

    def __init__(
        self,
        device_id: str,
        specimen: Specimen,
        timing: Timing,
        *,
        is_allowed: bool,
        truth: Truth,
        deliver: Deliver,
    ) -> None:
        self.device_id = device_id
        self.signals = Signals(specimen.wearer)
        self.truth = truth
        self.is_allowed = is_allowed
        # Whether a client ended its link, so the server does not reconnect it by itself.
        self.is_left_alone = False
        self._timing = timing
        self._drift_ppm = specimen.drift_ppm
        self._rng = np.random.default_rng((specimen.seed, 0xE4))
        self._deliver = deliver
        self._is_on = True
        self._is_lost = False
        self._is_in_reach = True
        self._link: RadioLink | None = None
        self._patience_s = inf
        self._gives_up: asyncio.TimerHandle | None = None

    def begin(self, clock: WallClock) -> None:
        """Start the time of the wearer, the oscillator and the server's PC."""
        self._begin_s = clock.lsl()
        self.oscillator = Oscillator(clock.lsl, self._drift_ppm, self._begin_s)
        self._clock = clock
        self.stamps = Stamps(clock)

    @property
    def is_connected(self) -> bool:
        """Whether it has a radio link."""
        return self._link is not None and not self._is_lost

    @property
    def is_lost(self) -> bool:
        """Whether it was connected and then went out of range."""
        return self._is_lost

    @property
    def is_advertising(self) -> bool:
        """Whether a radio link is possible."""
        return self._is_on and self._is_in_reach and not self.is_connected

    def connect(self, patience_s: float = inf) -> None:
        """Create a radio link, from which it streams with a new time reference.

        Parameters
        ----------
        patience_s
            How long it stays discoverable after the link was lost.
        """
        self._end_link()
        self._patience_s = patience_s
        self._is_lost = self.is_left_alone = False
        self.stamps = Stamps(self._clock)
        self._link = RadioLink(
            self.signals, self.oscillator, self._begin_s, self._timing, self._rng, self._arrived
        )

    def disconnect(self) -> None:
        """End the radio link properly; the wristband advertises again."""
        self._end_link()
        self._is_lost = False

    def lose(self) -> None:
        """Move it out of range; data measured meanwhile never arrive."""
        self._is_in_reach = False
        if self.is_connected:
            self._is_lost = True
            if self._patience_s < inf:
                loop = asyncio.get_running_loop()
                self._gives_up = loop.call_later(self._patience_s, self._give_up)

    def come_back(self) -> None:
        """Move it back into range."""
        self._is_in_reach = True

    def turn_off(self) -> None:
        """Turn it off by its button."""
        self._give_up()

    def turn_on(self) -> None:
        """Turn it on by its button."""
        self._is_on = True

    def press_button(self) -> None:
        """Send a tag, if there is a radio link."""
        if self._link is not None:
            self._link.tag()

    def _arrived(self, packet: Packet) -> None:
        self._deliver(self, packet)

    def _give_up(self) -> None:
        self.disconnect()
        self._is_on = False

    def _end_link(self) -> None:
        if self._gives_up is not None:
            self._gives_up.cancel()
            self._gives_up = None
        if self._link is not None:
            self._link.end()
            self._link = None
