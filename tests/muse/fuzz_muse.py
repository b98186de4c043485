"""What a Muse headband sends: packets, frames and answers, on any of its characteristics.

Nothing raises; no more is dropped than came; times are finite and in order; no negative number
of samples is lost.
"""

from __future__ import annotations

from biosensor_gateway.devices.muse.driver.emitter import MuseEmitter
from biosensor_gateway.devices.muse.driver.protocol import (
    ACC,
    AUX,
    CONTROL,
    EEG,
    FRAMES,
    GYRO,
    PPG,
    TELEMETRY,
    Answers,
    battery_percent,
    return_code,
    text_of,
)
from biosensor_gateway.devices.muse.driver.sample_clock import PacketSeries
from biosensor_gateway.transports.ble import Notification
from tests.fuzz.breaking import Fault, always
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, counted, hex_of, vectors
from tests.fuzz.streams import counted_pieces

_SOURCES = (*EEG, AUX, *PPG, ACC, GYRO, TELEMETRY, *FRAMES, CONTROL)
_KINDS = {"eeg": EEG[0], "light": PPG[0], "acc": ACC, "gyro": GYRO, "telemetry": TELEMETRY}
_EVERYTHING = frozenset({"eeg", "aux", "ppg", "optics", "acc", "gyro"})
_LONGEST_VALUE = 512
_PIECE_BYTES = 20


def check(data: bytes) -> None:
    """Read notifications in their order, as of one connection; the first byte says whence."""
    sink = CheckedSink("muse")
    emitter = MuseEmitter(sink)
    emitter.started(_EVERYTHING, 50.0)
    answers = Answers()
    series = PacketSeries(1 << 8, 4, 256.0)
    came = 0
    for number, piece in enumerate(counted_pieces(data)):
        if not piece:
            continue
        uuid, value = _SOURCES[piece[0] % len(_SOURCES)], piece[1:_LONGEST_VALUE]
        _check_place(series, piece[0], number)
        if uuid == CONTROL:
            _check_answer(answers, value)
            continue
        came += len(value)
        emitter.take(Notification(uuid, value, ARRIVAL_S + number * 0.01))
        ensure(sink.dropped_bytes <= came, "more is dropped than came", sink.dropped_bytes, came)


def _check_answer(answers: Answers, piece: bytes) -> None:
    answer = answers.feed(piece)
    if answer is None:
        return
    return_code(answer)
    percent = battery_percent(answer)
    ensure(percent is None or 0 <= percent <= 100, "no percentage", percent)
    ensure(text_of(answer, "sn").isprintable(), "not to be printed", answer)


def _check_place(series: PacketSeries, number: int, time: int) -> None:
    place = series.place(number, ARRIVAL_S + time * 0.01)
    ensure(place.lost >= 0, "a negative number is lost", place)


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    found = [each for each in vectors("muse/vectors/muse.json") if each["kind"] != "command"]
    yield from counted(
        (name, bytes([_SOURCES.index(_KINDS.get(kind, FRAMES[0]))]) + data)
        for kind, (name, data) in zip((each["kind"] for each in found), hex_of(found), strict=True)
        if kind != "answer"
    )
    control = bytes([_SOURCES.index(CONTROL)])
    yield from counted(
        (f"{name}_{at}", control + data[at : at + _PIECE_BYTES])
        for name, data in hex_of(each for each in found if each["kind"] == "answer")
        for at in range(0, len(data), _PIECE_BYTES)
    )


FAULT: Fault = (
    "biosensor_gateway.devices.muse.driver.sample_clock.PacketSeries",
    "_missing",
    always(-1),
)
"""How the reader is broken to see that the corpus finds it."""
