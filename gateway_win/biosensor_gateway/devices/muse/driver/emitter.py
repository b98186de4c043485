"""Converts a headband's data to samples of the declared streams.

A Muse 2 or Muse S sends numbered packets without timestamps, with one characteristic per channel;
an Athena sends frames of blocks with its clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from biosensor_common.device_clock import LONGEST_DELAY_S
from biosensor_gateway.devices.muse import (
    EEG_HZ,
    LIGHT_HZ,
    LIGHT_LABELS,
    MOTION_HZ,
    SPEC,
)
from biosensor_gateway.devices.muse.driver import frames
from biosensor_gateway.devices.muse.driver.frames import Block, Frame, Kind
from biosensor_gateway.devices.muse.driver.protocol import (
    ACC,
    ACC_G,
    AUX,
    EEG,
    EEG_SAMPLES,
    FRAMES,
    FULLEST_PERCENT,
    GYRO,
    GYRO_DPS,
    LIGHT_SAMPLES,
    MOTION_SAMPLES,
    NUMBERS,
    PPG,
    TELEMETRY,
    Floats,
    Packet,
    parse_charge,
    parse_eeg,
    parse_light,
    parse_motion,
)
from biosensor_gateway.devices.muse.driver.sample_clock import PacketSeries, SampleClock
from biosensor_gateway.devices.restart_check import RestartCheck
from biosensor_gateway.system.device_log import DeviceLog
from biosensor_gateway.transports.ble import Notification

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_ELECTRODES = {uuid: channel for channel, uuid in enumerate((*EEG, AUX))}
_DIODES = {uuid: channel for channel, uuid in enumerate(PPG)}
_AXES = {ACC: ("acc", ACC_G), GYRO: ("gyro", GYRO_DPS)}
_AUX_LABELS = tuple(channel.label for channel in SPEC.stream("aux").channels)
_INPUTS = len(_AUX_LABELS)
PATIENCE = 20
"""A channel missing this often in a row, for a second of EEG, is assumed not to be sent by the
device. Of one that is, the next packet comes too late for its rows."""


class Rows(NamedTuple):
    """Samples of all channels.

    Attributes
    ----------
    samples : ndarray of float64, shape (n_samples, n_channels)
        NaN for a channel whose packet is missing.
    arrival_s
        Arrival of the newest packet.
    """

    number: int
    samples: Floats
    arrival_s: float


class RowAssembler:
    """Joins the packets of several channels with the same packet number.

    The packets of all channels arrive in sequence, so a packet with a different number completes
    the rows.

    Parameters
    ----------
    channels
        Maximum number of channels.
    """

    def __init__(self, channels: int, samples: int) -> None:
        # Number of samples whose packets came twice, or after their rows were returned.
        self.late = 0
        self._channels, self._samples = channels, samples
        self._held: dict[int, Floats] = {}
        self._number, self._arrival_s = 0, 0.0
        self._given_out: int | None = None
        self._absent = [0] * channels

    def take(self, channel: int, packet: Packet, arrival_s: float = 0.0) -> list[Rows]:
        """Add a packet; return the rows that are complete now: none, one or two."""
        if packet.number == self._given_out:
            # Too late or repeated: the rows with this number were already returned.
            self._absent[channel] = 0
            self.late += self._samples
            return []  # nothing is dropped: `late` counts it
        if self._held and packet.number == self._number and channel in self._held:
            self.late += self._samples
            return []  # nothing is dropped: `late` counts it
        complete: list[Rows] = []
        if self._held and packet.number != self._number:
            complete.append(self._give_out())
        self._number, self._arrival_s = packet.number, arrival_s
        self._held[channel] = packet.samples
        self._absent[channel] = 0
        if all(at in self._held or self._absent[at] >= PATIENCE for at in range(self._channels)):
            complete.append(self._give_out())
        return complete

    def forget(self) -> None:
        """Discard packets of an earlier connection."""
        self._held.clear()
        self._given_out = None

    def _give_out(self) -> Rows:
        rows = np.full((self._samples, self._channels), np.nan)
        for channel in range(self._channels):
            if channel in self._held:
                rows[:, channel] = self._held[channel]
            else:
                self._absent[channel] += 1
        self._held.clear()
        self._given_out = self._number
        return Rows(self._number, rows, self._arrival_s)


class _Numbered:
    """One series of packets or blocks, which contains one or more streams."""

    def __init__(
        self, sink: DeviceSink, log: DeviceLog, modulus: int, samples: int, rate_hz: float
    ) -> None:
        self.series = PacketSeries(modulus, samples, rate_hz)
        self._sink, self._log, self._samples = sink, log, samples
        self._clock = SampleClock(rate_hz)

    def place(
        self, packets: Sequence[tuple[int, float]], names: Sequence[str], own_delay_s: float = 0.0
    ) -> list[float]:
        """Return the times of the samples of packets, and count missing ones before them.

        Parameters
        ----------
        packets
            Number of each packet, and its arrival or creation time.
        names
            Data names of their streams.
        """
        places = [self.series.place(*packet) for packet in packets]
        if places[0].is_again:
            self._clock.restart()
        indices = [range(place.first, place.first + self._samples) for place in places]
        newest = ((own[-1], at_s) for own, (_, at_s) in zip(indices, packets, strict=True))
        self._clock.observe(*newest, own_delay_s=own_delay_s)
        lost = sum(place.lost for place in places)
        if lost and names:
            # nothing is dropped: `lost` counts them below
            self._log.warning(
                "samples were lost", data=names, count=lost, estimated=places[0].is_again
            )
        for name in names:
            self._sink.lost(name, lost)
        return self._clock.times(chain.from_iterable(indices))


class ClassicEmitter:
    """Emits the data of a Muse 2 or Muse S, over all its connections.

    They send no timestamps: samples are counted, and their times are based on the earliest
    arrivals.
    """

    def __init__(self, sink: DeviceSink, log: DeviceLog) -> None:
        self._sink = sink
        self._eeg = _Numbered(sink, log, NUMBERS, EEG_SAMPLES, EEG_HZ)
        self._light = _Numbered(sink, log, NUMBERS, LIGHT_SAMPLES, LIGHT_HZ)
        self._axes = {
            name: _Numbered(sink, log, NUMBERS, MOTION_SAMPLES, MOTION_HZ)
            for name in ("acc", "gyro")
        }
        self._has_aux = False
        self._percent: float | None = None
        self._electrodes = RowAssembler(len(EEG), EEG_SAMPLES)
        self._diodes = RowAssembler(len(PPG), LIGHT_SAMPLES)

    def started(self, *, has_aux: bool) -> None:
        """Expect restarted packet numbers, with or without an additional electrode."""
        for each in (self._eeg, self._light, *self._axes.values()):
            each.series.restart()
        if has_aux != self._has_aux:
            self._has_aux = has_aux
            self._electrodes = RowAssembler(len(EEG) + has_aux, EEG_SAMPLES)
        self._electrodes.forget()
        self._diodes.forget()

    def take(self, uuid: str, data: bytes, arrival_s: float) -> bool:
        """Emit the data of a characteristic; return whether they are valid."""
        if uuid in _ELECTRODES:
            return self._take_electrode(_ELECTRODES[uuid], data, arrival_s)
        if uuid in _DIODES:
            return self._take_diode(_DIODES[uuid], data, arrival_s)
        if uuid in _AXES:
            return self._take_axes(*_AXES[uuid], data, arrival_s)
        percent = parse_charge(data) if uuid == TELEMETRY else None
        if percent is not None and percent != self._percent:
            self._percent = percent
            self._sink.emit_at("bat", [percent], [arrival_s])
        return percent is not None

    def _take_electrode(self, channel: int, data: bytes, arrival_s: float) -> bool:
        packet = parse_eeg(data)
        if packet is None or channel >= len(EEG) + self._has_aux:
            return packet is not None
        for number, samples, newest_s in self._electrodes.take(channel, packet, arrival_s):
            streams = {"eeg": samples[:, : len(EEG)]}
            if self._has_aux:
                inputs = np.full((len(samples), _INPUTS), np.nan)
                inputs[:, 0] = samples[:, len(EEG)]
                self._sink.lacking["aux"] = _AUX_LABELS[1:]
                streams["aux"] = inputs
            self._emit(self._eeg, number, streams, newest_s)
        self._report_late(self._electrodes)
        return True

    def _take_diode(self, channel: int, data: bytes, arrival_s: float) -> bool:
        packet = parse_light(data)
        if packet is None:
            return False
        for number, samples, newest_s in self._diodes.take(channel, packet, arrival_s):
            self._emit(self._light, number, {"ppg": samples}, newest_s)
        self._report_late(self._diodes)
        return True

    def _report_late(self, rows: RowAssembler) -> None:
        late, rows.late = rows.late, 0
        if late:
            self._sink.left_out(late, "their packet came twice, or too late")

    def _take_axes(self, name: str, unit: float, data: bytes, arrival_s: float) -> bool:
        packet = parse_motion(data, unit)
        if packet is None:
            return False
        self._emit(self._axes[name], packet.number, {name: packet.samples}, arrival_s)
        return True

    def _emit(
        self, series: _Numbered, number: int, streams: Mapping[str, Floats], arrival_s: float
    ) -> None:
        times = series.place([(number, arrival_s)], list(streams), self._sink.own_delay())
        for name, samples in streams.items():
            self._sink.emit_at(name, samples, times)


AGREE_S = 0.4
"""Tolerance for detecting a restarted clock with the first frame of a connection."""
TURNED_BACK_S = 0.2
"""A frame has blocks of up to 150 ms, and its newest may be older than the previous frame's."""
# Four light channels are the ones between the eyes.
_LIGHTS = {Kind.LIGHT4: slice(4, 8), Kind.LIGHT8: slice(0, 8), Kind.LIGHT16: slice(0, 16)}
_CHARGE_PERCENT = (1 / 256, 1 / 512)
_SAMPLES = {
    Kind.EEG4: (4, EEG_HZ),
    Kind.EEG8: (2, EEG_HZ),
    Kind.LIGHT4: (3, LIGHT_HZ),
    Kind.LIGHT8: (2, LIGHT_HZ),
    Kind.LIGHT16: (1, LIGHT_HZ),
    Kind.MOTION: (3, MOTION_HZ),
}


class AthenaEmitter:
    """Emits the data of an Athena, over all its connections."""

    def __init__(self, sink: DeviceSink, log: DeviceLog) -> None:
        self._sink, self._log = sink, log
        self._wanted: frozenset[str] = frozenset()
        self._kinds = {
            kind: _Numbered(sink, log, frames.NUMBERS, *how) for kind, how in _SAMPLES.items()
        }
        self._counter: int | None = None
        self._restarts = RestartCheck(sink, AGREE_S)
        self._newest: tuple[float, float] | None = None
        self._percent: float | None = None
        self._charge_unit = 0.0
        self._emitted_percent: float | None = None

    def started(self, wanted: frozenset[str], percent: float | None) -> None:
        """Expect restarted frame numbers; see `MuseEmitter`."""
        self._wanted, self._percent = wanted, percent
        self._charge_unit = 0.0
        self._restarts.reconnected()
        self._begin_series()

    def take(self, data: bytes, arrival_s: float) -> int:
        """Emit the data of a notification; return its number of invalid bytes."""
        found, unread = frames.parse_notification(data)
        for frame in found:
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
            # nothing is dropped: each kind has its turn
            blocks = [block for block in frame.blocks if block.kind is kind]
            if blocks:
                self._emit(numbered, blocks)
        for block in frame.blocks:
            if block.kind is Kind.BATTERY:
                self._emit_charge(block)

    def _follow_clock(self, stamp_s: float, arrival_s: float) -> None:
        """Restart the clock mapping if the device restarted its clock."""
        # The first frame of a connection shows this best, because later ones may have waited for
        # the agent.
        counts_again = self._restarts.counts_again(stamp_s, arrival_s)
        if self._newest is None:
            return  # nothing is dropped: it is the very first packet
        pause_s = arrival_s - self._newest[1]
        apart_s = stamp_s - self._newest[0] - pause_s
        is_behind = stamp_s < self._newest[0] - TURNED_BACK_S
        if counts_again or is_behind or abs(apart_s) > LONGEST_DELAY_S + pause_s / 1000:
            # nothing is dropped: its clock starts again
            self._log.info("the device was switched off, and its count started again")
            self._sink.restart_clock()
            for each in self._kinds.values():
                each.series.forget()

    def _follow_counter(self, counter: int) -> None:
        """Start new series if the device did so silently."""
        steps = 1 if self._counter is None else (counter - self._counter) % frames.COUNTERS
        if not 0 < steps < frames.COUNTERS // 2:
            self._begin_series()
        self._counter = counter

    def _begin_series(self) -> None:
        self._counter = None
        for each in self._kinds.values():
            each.series.restart()

    def _emit(self, kind: _Numbered, blocks: Sequence[Block]) -> None:
        """Emit the blocks of one kind in a frame."""
        streams = _streams(blocks)
        names = [name for name in streams if name in self._wanted]
        times = kind.place([(block.number, block.stamp_s) for block in blocks], names)
        for name in names:
            self._sink.emit(name, streams[name], times)
        if "optics" in names:
            sent = LIGHT_LABELS[_LIGHTS[blocks[0].kind]]
            self._sink.lacking["optics"] = [each for each in LIGHT_LABELS if each not in sent]

    def _emit_charge(self, block: Block) -> None:
        """Emit the charge, in the unit that matches the status at the connection."""
        counts = frames.charge_counts(block)
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
    """Return the samples of blocks of one kind, by data name."""
    kind = blocks[0].kind
    if kind is Kind.MOTION:
        acceleration, rotation = frames.motion(blocks)
        return {"acc": acceleration, "gyro": rotation}
    if kind in (Kind.EEG4, Kind.EEG8):
        samples = frames.eeg_uv(blocks)
        inputs = {"aux": samples[:, len(EEG) :]} if kind is Kind.EEG8 else {}
        return {"eeg": samples[:, : len(EEG)], **inputs}
    samples = frames.light(blocks)
    rows = np.full((len(samples), len(LIGHT_LABELS)), np.nan)
    rows[:, _LIGHTS[kind]] = samples
    return {"optics": rows}


class MuseEmitter:
    """Converts packets to samples; one instance per device, over all its connections."""

    def __init__(self, sink: DeviceSink) -> None:
        self._sink = sink
        self._log = DeviceLog("biosensor_gateway.muse", sink.identity)
        self._classic = ClassicEmitter(sink, self._log)
        self._athena = AthenaEmitter(sink, self._log)

    def started(self, wanted: frozenset[str], percent: float | None) -> None:
        """Expect restarted packet numbers; call this before packets can arrive.

        Parameters
        ----------
        wanted
            Data names of the regular streams; other data are not emitted.
        percent
            Reported battery level; None if unknown.
        """
        self._classic.started(has_aux="aux" in wanted)
        self._athena.started(wanted, percent)

    def take(self, notification: Notification) -> None:
        """Emit the data of a notification; invalid data are counted and dropped."""
        data, arrival_s = notification.data, notification.arrival
        if notification.uuid in FRAMES:
            dropped = self._athena.take(data, arrival_s)
        else:
            is_readable = self._classic.take(notification.uuid, data, arrival_s)
            dropped = 0 if is_readable else len(data)
        if dropped:
            self._sink.dropped_bytes += dropped
            self._log.warn_once("packets are dropped", start=data[:10].hex())

    def signal_strength(self, rssi_dbm: int | None, seen_s: float) -> None:
        """Emit the signal strength of an advertisement; None is ignored."""
        if rssi_dbm is not None:
            self._sink.emit_at("rssi", [rssi_dbm], [seen_s])
