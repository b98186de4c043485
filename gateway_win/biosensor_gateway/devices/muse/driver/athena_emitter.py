"""Turns the frames of an Athena into samples."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from biosensor_common.device_clock import LONGEST_DELAY_S
from biosensor_gateway.devices.muse.declaration import EEG_HZ, LIGHT_HZ, LIGHT_LABELS, MOTION_HZ
from biosensor_gateway.devices.muse.driver.frames import (
    COUNTERS,
    NUMBERS,
    Block,
    Frame,
    Kind,
    charge_counts,
    eeg_uv,
    light,
    motion,
    parse_notification,
)
from biosensor_gateway.devices.muse.driver.gatt import EEG
from biosensor_gateway.devices.muse.driver.packets import FULLEST_PERCENT, Floats
from biosensor_gateway.devices.muse.driver.sample_clock import SampleClock
from biosensor_gateway.devices.muse.driver.series import PacketSeries
from biosensor_gateway.devices.restarts import RestartCheck
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.system.device_log import DeviceLog

AGREE_S = 0.4
"""How exactly the first frame of a connection tells whether the device stayed on."""
TURNED_BACK_S = 0.2
"""A frame holds blocks of 150 ms, and its newest may be older than that of the frame before."""
_INNER = slice(4, 8)
"""Four channels of light are those between the eyes."""
_CHARGE_PERCENT = (1 / 256, 1 / 512)
_SAMPLES = {
    Kind.EEG4: (4, EEG_HZ),
    Kind.EEG8: (2, EEG_HZ),
    Kind.LIGHT4: (3, LIGHT_HZ),
    Kind.LIGHT8: (2, LIGHT_HZ),
    Kind.LIGHT16: (1, LIGHT_HZ),
    Kind.MOTION: (3, MOTION_HZ),
}


class _Numbered:
    """Blocks of one kind."""

    def __init__(self, samples: int, rate_hz: float) -> None:
        self.samples = samples
        self.series = PacketSeries(NUMBERS, samples, rate_hz)
        self.clock = SampleClock(rate_hz)


class AthenaEmitter:
    """Emits what an Athena sends, over all its connections."""

    def __init__(self, sink: Sink, log: DeviceLog) -> None:
        self._sink, self._log = sink, log
        self._wanted: frozenset[str] = frozenset()
        self._kinds = {kind: _Numbered(*how) for kind, how in _SAMPLES.items()}
        self._counter: int | None = None
        self._restarts = RestartCheck(sink, AGREE_S)
        self._newest: tuple[float, float] | None = None
        self._percent: float | None = None
        self._charge_unit = 0.0
        self._emitted_percent: float | None = None

    def started(self, wanted: frozenset[str], percent: float | None) -> None:
        """Expect frames that are counted again.

        Parameters
        ----------
        wanted
            Data names; what else comes with them is not emitted.
        percent
            What is left in the battery, as far as the device has told.
        """
        self._wanted, self._percent = wanted, percent
        self._charge_unit = 0.0
        self._restarts.reconnected()
        self._begin_series()

    def take(self, data: bytes, arrival_s: float) -> int:
        """Emit what a notification holds; return how many of its bytes make no sense.

        Parameters
        ----------
        arrival_s
            LSL clock when it came.
        """
        frames, unread = parse_notification(data)
        for frame in frames:
            if frame.blocks:
                self._take_frame(frame, arrival_s)
        return unread

    def _take_frame(self, frame: Frame, arrival_s: float) -> None:
        newest_s = max(block.stamp_s for block in frame.blocks)
        self._follow_clock(newest_s, arrival_s)
        self._follow_counter(frame.counter)
        self._newest = newest_s, arrival_s
        self._sink.observe(newest_s, arrival_s)
        self._sink.heard()
        for kind, numbered in self._kinds.items():
            blocks = [block for block in frame.blocks if block.kind is kind]
            if blocks:
                self._emit(numbered, blocks)
        for block in frame.blocks:
            if block.kind is Kind.BATTERY:
                self._emit_charge(block)

    def _follow_clock(self, stamp_s: float, arrival_s: float) -> None:
        """Begin again where the device's clock did.

        The first frame of a connection tells best: later ones may have waited for the agent.
        """
        counts_again = self._restarts.counts_again(stamp_s, arrival_s)
        if self._newest is None:
            return  # nothing is dropped: it is the first packet of all
        pause_s = arrival_s - self._newest[1]
        apart_s = stamp_s - self._newest[0] - pause_s
        is_behind = stamp_s < self._newest[0] - TURNED_BACK_S
        if counts_again or is_behind or abs(apart_s) > LONGEST_DELAY_S + pause_s / 1000:
            # nothing is dropped: its clock starts again
            self._log.info("the device was switched off and counts again")
            self._sink.restart_clock()
            for each in self._kinds.values():
                each.series.forget()

    def _follow_counter(self, counter: int) -> None:
        """Begin new series where the device did without a word."""
        steps = 1 if self._counter is None else (counter - self._counter) % COUNTERS
        if not 0 < steps < COUNTERS // 2:
            self._begin_series()
        self._counter = counter

    def _begin_series(self) -> None:
        self._counter = None
        for each in self._kinds.values():
            each.series.restart()

    def _emit(self, kind: _Numbered, blocks: Sequence[Block]) -> None:
        """Emit the blocks of one kind in a frame."""
        places = [kind.series.place(block.number, block.stamp_s) for block in blocks]
        if places[0].is_again:
            kind.clock.restart()
        indices = [range(place.first, place.first + kind.samples) for place in places]
        stamps = [block.stamp_s for block in blocks]
        kind.clock.observe(
            *((own[-1], stamp_s) for own, stamp_s in zip(indices, stamps, strict=True))
        )
        times = kind.clock.times(chain.from_iterable(indices))
        lost = sum(place.lost for place in places)
        streams = _streams(blocks)
        names = [name for name in streams if name in self._wanted]
        if lost and names:
            estimated = places[0].is_again
            # nothing is dropped: `lost` counts them below
            self._log.warning("samples were lost", data=names, count=lost, estimated=estimated)
        for name in names:
            self._sink.lost(name, lost)
            self._sink.emit(name, streams[name], times)

    def _emit_charge(self, block: Block) -> None:
        """Emit the charge in the unit that fits what the device said at the connection."""
        counts = charge_counts(block)
        if not self._charge_unit:
            told = self._percent
            units = [unit for unit in _CHARGE_PERCENT if counts * unit <= FULLEST_PERCENT]
            if not units:
                return  # nothing is dropped: a charge above full is none
            self._charge_unit = (
                units[0] if told is None else min(units, key=lambda unit: abs(counts * unit - told))
            )
        shown = counts * self._charge_unit
        percent = min(100.0, shown)
        if shown <= FULLEST_PERCENT and percent != self._emitted_percent:
            self._emitted_percent = percent
            self._sink.emit("bat", [percent], [block.stamp_s])


def _streams(blocks: Sequence[Block]) -> dict[str, Floats]:
    """Return the samples of blocks of one kind by data name."""
    kind = blocks[0].kind
    if kind is Kind.MOTION:
        acceleration, rotation = motion(blocks)
        return {"acc": acceleration, "gyro": rotation}
    if kind in (Kind.EEG4, Kind.EEG8):
        samples = eeg_uv(blocks)
        inputs = {"aux": samples[:, len(EEG) :]} if kind is Kind.EEG8 else {}
        return {"eeg": samples[:, : len(EEG)], **inputs}
    samples = light(blocks)
    rows = np.full((len(samples), len(LIGHT_LABELS)), np.nan)
    columns = _INNER if kind is Kind.LIGHT4 else slice(0, samples.shape[1])
    rows[:, columns] = samples
    return {"optics": rows}
