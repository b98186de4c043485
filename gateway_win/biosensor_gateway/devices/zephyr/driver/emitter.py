"""Turns BioHarness messages into samples of the declared streams."""

from __future__ import annotations

import math

from numpy.typing import ArrayLike

from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.devices.zephyr.driver.frames import MessageId
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
)
from biosensor_gateway.devices.zephyr.driver.tracking import BeatDetector, PacketTrack, Placed
from biosensor_gateway.system.device_log import DeviceLog

_WAVEFORMS = {MessageId.ECG: "ecg", MessageId.BREATHING: "breathing"}
_VITALS_PERIOD_S = 1.0
_NAN = math.nan


class ZephyrEmitter:
    """Turns messages into samples; one instance a device, over all its connections."""

    def __init__(self, sink: Sink) -> None:
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
        """Emit what a message holds; messages without values are passed over.

        Parameters
        ----------
        arrival_s
            LSL clock when the message's last byte arrived.
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
        """Return the place of a packet; None for one that came before."""
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
            # How many beats fell into the gap is unknown, so none is counted as lost.
            self._beats.reset()
        for index, interval_s in self._beats.beats(message):
            self._sink.emit_value("ibi", interval_s, times[index])

    def _emit_vitals(
        self, header: Header, values: dict[str, float | None], arrival_s: float
    ) -> None:
        placed = self._placed("vitals", header, arrival_s)
        if placed is None:
            return  # nothing is dropped: `_placed` counts it
        time_s = placed.stamp_s
        self._sink.observe(time_s, arrival_s, "vitals")
        for data_name in self._vitals if placed.lost_packets else ():
            # An estimate: what the last packet held, the lost ones will have held.
            self._sink.lost(data_name, placed.lost_packets)
        self._vitals = {"quality", *(name for name, value in values.items() if value is not None)}
        for data_name, value in values.items():
            self._sink.emit_value(data_name, value, time_s)
        self._sink.emit("quality", [self._quality], [time_s])

    def _summary(self, message: Summary, arrival_s: float) -> None:
        numbers, flags = message.numbers, message.status.flags
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
            # The one flag that makes a value "no value"; the others only go into quality.
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
    """Return a rate; the device says 0 while it has found none."""
    return value or None


def _number(value: float | None) -> float:
    return _NAN if value is None else value
