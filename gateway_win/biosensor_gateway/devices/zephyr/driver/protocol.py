"""BioHarness 3 protocol: bytes in, typed messages out; no I/O and no clock.

Layouts are those of zephyr-bt and App-Zephyr, confirmed by recordings of a
real device. Unknown messages are passed on as :class:`Unknown`, never raised.
"""

from __future__ import annotations

import datetime as dt
import struct
from collections.abc import Callable
from enum import IntEnum

from biosensor_gateway.devices.zephyr.driver import fields
from biosensor_gateway.devices.zephyr.driver.fields import read_bits, read_fields
from biosensor_gateway.devices.zephyr.driver.frames import (
    Frame,
    FrameParser,
    MessageId,
    Terminator,
    request,
)
from biosensor_gateway.devices.zephyr.driver.messages import (
    Acceleration,
    Event,
    General,
    Header,
    Lifesign,
    Message,
    Reply,
    RrIntervals,
    Status,
    Summary,
    Unknown,
    Waveform,
)

ECG_PERIOD_S = 0.004
BREATHING_PERIOD_S = 0.056
RR_PERIOD_S = 0.056
ACCELERATION_PERIOD_S = 0.02

_HEADER = struct.Struct("<BHBBI")
_HEADER_SIZE = 9
_MS_PER_DAY = 86_400_000
# No clock reads more; a later one is a clock that is not set.
_LAST_YEAR = 2999


class Request(IntEnum):
    """Every request that a driver may send; other ids can erase or reconfigure the device."""

    GENERAL = 0x14
    BREATHING = 0x15
    ECG = 0x16
    RR = 0x19
    ACCELERATION = 0x1E
    LIFESIGN = 0x23
    SUMMARY = 0xBD


_REPLY_IDS = frozenset(Request) - {Request.LIFESIGN}
LIFESIGN = request(Request.LIFESIGN)


def enable(packet: Request, *, on: bool) -> bytes:
    """Bytes that switch one periodic packet on (the summary: once a second) or off."""
    if packet is Request.SUMMARY:
        return request(packet, struct.pack("<H", int(on)))
    return request(packet, bytes((on,)))


EVENT_NAMES = {
    0x0040: "button_press",
    0x0041: "emergency_button",
    0x0080: "battery_low",
    0x00C0: "self_test",
    0x1000: "rog_change",
    0x1040: "worn_change",
    0x1080: "hr_reliability_change",
    0x10C0: "fall",
    0x1100: "jump",
    0x1140: "dash",
}
_ROG = {1: "green", 2: "orange", 3: "red"}


class ZephyrProtocol:
    """Incremental decoder of one connection's bytes.

    ``feed`` never raises, whatever the bytes; what it cannot use is counted.
    """

    def __init__(self) -> None:
        self._frames = FrameParser()

    @property
    def dropped_bytes(self) -> int:
        """Bytes that belonged to no valid frame."""
        return self._frames.dropped_bytes

    @property
    def buffered(self) -> int:
        """Bytes held back as the possible start of a frame."""
        return self._frames.buffered

    def feed(self, data: bytes) -> list[Message]:
        """Take the next bytes, in pieces of any size; return the messages that they complete."""
        return [decode(frame) for frame in self._frames.feed(data)]

    def give_up(self) -> list[Message]:
        """Give up a frame whose rest did not come; call it after a second of silence."""
        return [decode(frame) for frame in self._frames.give_up()]


def decode(frame: Frame) -> Message:
    """Turn one frame into a message."""
    decoder = _DECODERS.get(frame.message_id)
    if decoder is not None:
        return decoder(frame)
    # A request that is merely echoed ends in ETX and answers nothing.
    if frame.message_id in _REPLY_IDS and frame.terminator is not Terminator.ETX:
        return Reply(frame.message_id, frame.terminator is Terminator.ACK, frame.payload)
    return Unknown(frame.message_id)


def unpack_10bit(payload: bytes, count: int) -> tuple[int, ...]:
    """Unpack *count* unsigned 10-bit samples, least significant bit first."""
    bits = int.from_bytes(payload, "little")
    return tuple(bits >> shift & 0x3FF for shift in range(0, 10 * count, 10))


def _header(payload: bytes) -> Header:
    sequence, year, month, day, ms_of_day = _HEADER.unpack_from(payload)
    if ms_of_day >= _MS_PER_DAY or year > _LAST_YEAR:
        return Header(sequence, None)
    try:
        midnight = dt.datetime(year, month, day)  # noqa: DTZ001 - naive, as the device means it
    except ValueError:
        return Header(sequence, None)
    return Header(sequence, midnight + dt.timedelta(milliseconds=ms_of_day))


def _ecg(frame: Frame) -> Waveform:
    samples = unpack_10bit(frame.payload[_HEADER_SIZE:], 63)
    return Waveform(MessageId.ECG, _header(frame.payload), samples, ECG_PERIOD_S)


def _breathing(frame: Frame) -> Waveform:
    samples = unpack_10bit(frame.payload[_HEADER_SIZE:], 18)
    return Waveform(MessageId.BREATHING, _header(frame.payload), samples, BREATHING_PERIOD_S)


def _triples(flat: tuple[int, ...]) -> tuple[tuple[int, int, int], ...]:
    return tuple(zip(flat[0::3], flat[1::3], flat[2::3], strict=True))


def _acceleration(frame: Frame) -> Acceleration:
    flat = unpack_10bit(frame.payload[_HEADER_SIZE:], 60)
    return Acceleration(_header(frame.payload), _triples(flat))


def _acceleration_100mg(frame: Frame) -> Acceleration:
    flat = unpack_10bit(frame.payload[_HEADER_SIZE:], 60)
    signed = tuple(count - 1024 if count >= 512 else count for count in flat)
    return Acceleration(_header(frame.payload), _triples(signed), counts_per_g=10, zero=0)


def _rr(frame: Frame) -> RrIntervals:
    samples = struct.unpack_from("<18h", frame.payload, _HEADER_SIZE)
    return RrIntervals(_header(frame.payload), samples)


def _summary(frame: Frame) -> Summary | Unknown:
    payload, version = frame.payload, frame.payload[9]
    layout = fields.SUMMARY_LAYOUTS.get(version)
    if layout is None:
        return Unknown(frame.message_id)
    table, rog_at, status_at = layout
    (rog,) = struct.unpack_from("<H", payload, rog_at)
    (status,) = struct.unpack_from("<H", payload, status_at)
    return Summary(
        header=_header(payload),
        version=version,
        numbers=read_fields(table, payload),
        status=Status(status),
        rog_status=_ROG.get(rog & 7, "invalid"),
        rog_time_s=rog >> 3,
        extra=_summary_extra(payload) if version == 3 else {},
    )


def _summary_extra(payload: bytes) -> dict[str, dict[str, int | float]]:
    end = fields.GPS_OFFSET + fields.GPS_SIZE
    gps: dict[str, int | float] = dict(read_bits(payload[fields.GPS_OFFSET : end], fields.GPS))
    gps["speed"] = struct.unpack_from("<H", payload, fields.SPEED_OFFSET)[0] & 0x3FFF
    bits = read_bits(payload[fields.MOVEMENT_OFFSET :], fields.MOVEMENT)
    if bits["peak_accel_theta"] >= 512:
        bits["peak_accel_theta"] -= 1024
    movement: dict[str, int | float] = {
        name: value / fields.MOVEMENT_DIVISORS[name] if name in fields.MOVEMENT_DIVISORS else value
        for name, value in bits.items()
    }
    return {"gps": gps, "movement": movement}


def _general(frame: Frame) -> General:
    battery, state = frame.payload[51], frame.payload[52]
    return General(
        header=_header(frame.payload),
        numbers=read_fields(fields.GENERAL, frame.payload),
        battery_percent=battery & 0x7F,
        worn=bool(state & 0x80),
        button=bool(state & 0x40),
        hr_signal_low=bool(state & 0x20),
        external_sensors=bool(state & 0x10),
    )


def _event(frame: Frame) -> Event:
    (code,) = struct.unpack_from("<H", frame.payload, _HEADER_SIZE)
    return Event(_header(frame.payload), code, EVENT_NAMES.get(code, "unknown"), frame.payload[11:])


def _lifesign(_: Frame) -> Lifesign:
    return Lifesign()


_DECODERS: dict[int, Callable[[Frame], Message]] = {
    MessageId.GENERAL: _general,
    MessageId.BREATHING: _breathing,
    MessageId.ECG: _ecg,
    MessageId.LIFESIGN: _lifesign,
    MessageId.RR: _rr,
    MessageId.ACCELERATION: _acceleration,
    MessageId.ACCELERATION_100MG: _acceleration_100mg,
    MessageId.SUMMARY: _summary,
    MessageId.EVENT: _event,
}
