"""Turns the packets of headbands before the Athena into samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.muse.declaration import EEG_HZ, LIGHT_HZ, MOTION_HZ, SPEC
from biosensor_gateway.devices.muse.driver.gatt import ACC, AUX, EEG, GYRO, PPG, TELEMETRY
from biosensor_gateway.devices.muse.driver.packets import (
    ACC_G,
    EEG_SAMPLES,
    GYRO_DPS,
    LIGHT_SAMPLES,
    MOTION_SAMPLES,
    NUMBERS,
    Floats,
    Packet,
    parse_charge,
    parse_eeg,
    parse_light,
    parse_motion,
)
from biosensor_gateway.devices.muse.driver.sample_clock import SampleClock
from biosensor_gateway.devices.muse.driver.series import PacketSeries
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.system.device_log import DeviceLog

_ELECTRODES = {uuid: channel for channel, uuid in enumerate((*EEG, AUX))}
_DIODES = {uuid: channel for channel, uuid in enumerate(PPG)}
_AXES = {ACC: ("acc", ACC_G), GYRO: ("gyro", GYRO_DPS)}
_INPUTS = len(SPEC.stream("aux").channels)

PATIENCE = 3
"""A channel that is missing so often in a row is taken for one that the device does not send."""


class Rows(NamedTuple):
    """Samples of all channels.

    Attributes
    ----------
    number
        Of the packets.
    samples : ndarray of float64, shape (n_samples, n_channels)
        NaN of a channel whose packet is missing.
    arrival_s
        Of the newest of their packets.
    """

    number: int
    samples: Floats
    arrival_s: float


class RowAssembler:
    """Collects the packets of channels that share their numbers.

    The channels of a moment come one after the other, so a packet of another number ends it.

    Parameters
    ----------
    channels
        How many there may be.
    samples
        In each packet.
    """

    def __init__(self, channels: int, samples: int) -> None:
        self._channels, self._samples = channels, samples
        self._held: dict[int, Floats] = {}
        self._number, self._arrival_s = 0, 0.0
        self._given_out: int | None = None
        self._absent = [0] * channels

    def take(self, channel: int, packet: Packet, arrival_s: float = 0.0) -> list[Rows]:
        """Return what is complete now: nothing, a moment, or two."""
        if packet.number == self._given_out:
            # It is later than it was waited for, or came twice: this moment has its rows.
            self._absent[channel] = 0
            # nothing is dropped: this moment has its rows, and says NaN where they were late
            return []
        if self._held and packet.number == self._number and channel in self._held:
            return []  # nothing is dropped: it came before
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
        """Begin again: what is held is of an earlier connection."""
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
    """One series of packets, which fills one stream or several."""

    def __init__(self, sink: Sink, log: DeviceLog, samples: int, rate_hz: float) -> None:
        self.series = PacketSeries(NUMBERS, samples, rate_hz)
        self._sink, self._log, self._samples = sink, log, samples
        self._clock = SampleClock(rate_hz)

    def emit(self, number: int, streams: Mapping[str, Floats], arrival_s: float) -> None:
        """Emit the samples of a packet, by data name."""
        place = self.series.place(number, arrival_s)
        if place.is_again:
            self._clock.restart()
        last = place.first + self._samples - 1, arrival_s
        self._clock.observe(last, own_delay_s=self._sink.own_delay())
        times = self._clock.times(range(place.first, place.first + self._samples))
        if place.lost:
            # nothing is dropped: `lost` counts them below
            self._log.warning(
                "samples were lost",
                data=list(streams),
                count=place.lost,
                estimated=place.is_again,
            )
        for name, samples in streams.items():
            self._sink.lost(name, place.lost)
            self._sink.emit_at(name, samples, times)


class ClassicEmitter:
    """Emits what a Muse 2 or Muse S sends, over all its connections.

    They send no time: samples are counted, and placed by the earliest arrivals.
    """

    def __init__(self, sink: Sink, log: DeviceLog) -> None:
        self._sink = sink
        self._eeg = _Numbered(sink, log, EEG_SAMPLES, EEG_HZ)
        self._light = _Numbered(sink, log, LIGHT_SAMPLES, LIGHT_HZ)
        self._axes = {name: _Numbered(sink, log, MOTION_SAMPLES, MOTION_HZ) for name in
            ("acc", "gyro")}  # fmt: skip
        self._has_aux = False
        self._percent: float | None = None
        self._electrodes = RowAssembler(len(EEG), EEG_SAMPLES)
        self._diodes = RowAssembler(len(PPG), LIGHT_SAMPLES)

    def started(self, *, has_aux: bool) -> None:
        """Expect packets that are counted again, with or without an electrode of one's own."""
        for each in (self._eeg, self._light, *self._axes.values()):
            each.series.restart()
        if has_aux != self._has_aux:
            self._has_aux = has_aux
            self._electrodes = RowAssembler(len(EEG) + has_aux, EEG_SAMPLES)
        self._electrodes.forget()
        self._diodes.forget()

    def take(self, uuid: str, data: bytes, arrival_s: float) -> bool:
        """Emit what a characteristic sent; return whether it made sense.

        Parameters
        ----------
        arrival_s
            LSL clock when it came.
        """
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
                streams["aux"] = inputs
            self._eeg.emit(number, streams, newest_s)
        return True

    def _take_diode(self, channel: int, data: bytes, arrival_s: float) -> bool:
        packet = parse_light(data)
        if packet is None:
            return False
        for number, samples, newest_s in self._diodes.take(channel, packet, arrival_s):
            self._light.emit(number, {"ppg": samples}, newest_s)
        return True

    def _take_axes(self, name: str, unit: float, data: bytes, arrival_s: float) -> bool:
        packet = parse_motion(data, unit)
        if packet is None:
            return False
        self._axes[name].emit(packet.number, {name: packet.samples}, arrival_s)
        return True
