"""Data frames of the PMD service, with which a strap sends ECG and acceleration.

Nothing raises; a frame expands by a known factor at most; samples fit their width;
times are in order.
"""

from __future__ import annotations

import math

from biosensor_gateway.devices.polar_h10.driver.emitter import FrameTimeline, PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import (
    Acceleration,
    Ecg,
    MagneticField,
    Ppg,
    PulseIntervals,
    Rejected,
    Rotation,
    parse_frame,
)
from tests.fuzz.breaking import Fault
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, counted
from tests.fuzz.streams import counted_pieces
from tests.polar_h10.pmd_vectors import pmd_vectors

_ECG_LIMIT = 1 << 23
_MAX_BLOCK = 255
# Of a Bluetooth attribute.
_LONGEST_VALUE = 512


def check(data: bytes) -> None:
    """Read the frames in their order, as of one connection."""
    timeline = FrameTimeline(130.0)
    emitter = PolarEmitter(CheckedSink("polar_h10"))
    emitter.started(Measurement.ECG, 130.0, 1.0)
    emitter.started(Measurement.ACCELERATION, 50.0, 0.001)
    emitter.started(Measurement.PULSE_INTERVALS, None, 1.0)
    for number, piece in enumerate(counted_pieces(data)):
        arrival_s = ARRIVAL_S + number
        frame = piece[:_LONGEST_VALUE]
        _check_frame(frame, timeline, arrival_s)
        emitter.frame(frame, arrival_s)


def _check_frame(piece: bytes, timeline: FrameTimeline, arrival_s: float) -> None:
    frame = parse_frame(piece, {})
    count = 0
    match frame:
        case Ecg():
            count = len(frame.microvolts)
            fits = all(-_ECG_LIMIT <= value < _ECG_LIMIT for value in frame.microvolts)
            ensure(fits, "an ECG sample does not fit into 24 bits", frame)
        case Acceleration() | Ppg() | Rotation() | MagneticField():
            count = len(frame.counts)
        case PulseIntervals():
            count = len(frame.intervals)
        case Rejected():
            return
    ensure(count <= 1 + len(piece) // 2 * _MAX_BLOCK, "it holds too many samples", count)
    if count:
        placed = timeline.place(frame.header.timestamp_ns, count, arrival_s)
        times = placed.times_ns
        ensure(len(times) == count, "not every sample has a time", count, times)
        ensure(times == sorted(times), "times run backwards", times)
        ensure(placed.lost >= 0, "a negative number is lost", placed.lost)


def seeds() -> Seeds:
    """Return the frames of the vectors."""
    return counted(pmd_vectors(on_data=True))


FAULT: Fault = (
    "biosensor_gateway.devices.polar_h10.driver.emitter",
    "RATE_TOLERANCE",
    lambda _: math.inf,
)
"""How the reader is broken to see that the corpus finds it."""
