"""Recordings as nobody should make them, and somebody does: wrong stamps, headers and chunks."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable, Sequence
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from tests.xdf import xdf_file as made

Array = NDArray[np.float64]

RATE, COUNT = 130.0, 2600
BEGIN_S = 1000.0
CHUNK = 100


def _even(begin: float = 0.0, count: int = COUNT, rate: float = RATE) -> Array:
    return BEGIN_S + begin + np.arange(count) / rate


def _wave(count: int, channels: int = 1) -> list[list[float]]:
    number = np.arange(count * channels, dtype=np.float64).reshape(count, channels)
    return np.sin(number / 7).astype(np.float32).tolist()


def _chunks(
    number: int,
    stamps: Sequence[float | None],
    values: Sequence[Sequence[Any]],
    fmt: str = "float32",
    chunk: int = CHUNK,
) -> bytes:
    return b"".join(
        made.samples(number, fmt, values[at : at + chunk], stamps[at : at + chunk])
        for at in range(0, len(stamps), chunk)
    )


def _signal(
    stamps: Array,
    number: int = 1,
    name: str = "ecg",
    *,
    values: Sequence[Sequence[Any]] | None = None,
    clock: Sequence[tuple[float, float]] | None = None,
    ends: bool = True,
    chunk: int = CHUNK,
    **header: Any,
) -> bytes:
    known: dict[str, Any] = {"kind": "ECG", "rate": RATE, "source_id": f"id{number}"} | header
    rows = _wave(len(stamps), known.get("channels", 1)) if values is None else values
    if clock is None and len(stamps):
        clock = [(float(stamps[0]), 0.0), (float(stamps[-1]), 0.0)]
    parts = [
        made.stream_header(number, name, **known),
        _chunks(number, stamps.tolist(), rows, known.get("fmt", "float32"), chunk),
        *(made.clock_offset(number, *each) for each in clock or ()),
        made.footer(number, len(stamps)) if ends else b"",
    ]
    return b"".join(parts)


def _events(
    texts: Sequence[str] = ("begin", "in the middle", "end"),
    number: int = 2,
    *,
    stamps: Sequence[float] | None = None,
    **header: Any,
) -> bytes:
    times = [BEGIN_S + 0.5 + each for each in range(len(texts))] if stamps is None else list(stamps)
    known: dict[str, Any] = {"name": "events", "kind": "Markers", "fmt": "string"} | header
    return b"".join(
        (
            made.stream_header(number, **known),
            made.samples(number, "string", [[text] for text in texts], times),
            made.offsets(number, (times[0], times[-1])) if times else b"",
            made.footer(number, len(texts)),
        )
    )


def _with_field(header: bytes, field: bytes, text: bytes) -> bytes:
    """Return the parts of a stream with another text in a field of its header."""
    begin = header.index(b"<" + field + b">") + len(field) + 2
    end = header.index(b"</" + field + b">")
    size = int.from_bytes(header[1:5], "little")
    changed = header[:begin] + text + header[end:]
    return changed[:1] + (size + len(text) - (end - begin)).to_bytes(4, "little") + changed[5:]


def _channels(labels: Sequence[str], units: Sequence[str] = ()) -> ET.Element:
    desc = ET.Element("desc")
    channels = ET.SubElement(desc, "channels")
    for at, label in enumerate(labels):
        channel = ET.SubElement(channels, "channel")
        ET.SubElement(channel, "label").text = label
        ET.SubElement(channel, "unit").text = units[at] if units else "microvolts"
    return desc


def _raw_header(number: int, xml: bytes) -> bytes:
    return made.chunk(2, struct.pack("<I", number) + xml)


def _xml(encoding: str, name: str) -> bytes:
    text = (
        f"<?xml version='1.0' encoding='{encoding}'?><info><name>{name}</name><type>ECG</type>"
        "<channel_count>1</channel_count><nominal_srate>130</nominal_srate>"
        "<channel_format>float32</channel_format><source_id>id1</source_id><desc/></info>"
    )
    return text.encode(encoding if encoding != "utf-8" else "utf-8")


def _decreasing() -> list[bytes]:
    return [_signal(_even()[::-1].copy()), _events()]


def _shuffled() -> list[bytes]:
    order = np.random.default_rng(1).permutation(COUNT)
    return [_signal(_even()[order]), _events()]


def _all_equal() -> list[bytes]:
    return [_signal(np.full(COUNT, BEGIN_S)), _events()]


def _doubled() -> list[bytes]:
    return [_signal(np.repeat(_even(count=COUNT // 2, rate=RATE / 2), 2)), _events()]


def _nan_stamps() -> list[bytes]:
    stamps = _even()
    stamps[5:2000:7] = np.nan
    stamps[2100] = np.inf
    stamps[2200] = -np.inf
    return [_signal(stamps, clock=[(BEGIN_S, 0.0)]), _events()]


def _only_nan_stamps() -> list[bytes]:
    return [_signal(np.full(COUNT, np.nan), clock=[(BEGIN_S, 0.0)]), _events()]


def _huge_stamps() -> list[bytes]:
    stamps = _even()
    stamps[1000:] += 1e300
    return [_signal(stamps), _events()]


def _largest_stamps() -> list[bytes]:
    stamps = _even()
    stamps[1300:] = -1e308
    return [_signal(stamps), _events()]


def _days() -> list[bytes]:
    stamps = _even()
    stamps[1000:] += 5 * 86400.0
    return [_signal(stamps), _events()]


def _negative_stamps() -> list[bytes]:
    return [_signal(_even() - 5000.0), _events(stamps=[-3999.0, -3998.0, -3997.0])]


def _one_uid() -> list[bytes]:
    def block(number: int, name: str) -> bytes:
        desc = ET.Element("desc")
        header = made.stream_header(
            number, name, kind="ECG", rate=RATE, source_id="same", desc=desc
        )
        uid = b"<uid>11111111-2222-3333-4444-555555555555</uid></info>"
        xml = header[11:].replace(b"</info>", uid)
        return _raw_header(number, xml) + _chunks(number, _even().tolist(), _wave(COUNT))

    return [block(1, "ecg"), block(3, "ecg"), _events()]


def _one_number() -> list[bytes]:
    """Two streams with one number: the second header is another one's."""
    return [
        _signal(_even()),
        _signal(_even(begin=30.0), name="other", channels=2, kind="EEG"),
        _events(),
    ]


def _no_channels() -> list[bytes]:
    none = made.stream_header(3, "none", channels=0, rate=RATE)
    nothing: list[list[float]] = [[], [], []]
    return [_signal(_even()), none, made.samples(3, "float32", nothing, [1001.0, 1002.0, 1003.0])]


def _texts_with_a_rate() -> list[bytes]:
    stamps = _even(rate=10.0, count=100)
    texts = [f"state {each}" for each in range(100)]
    return [_signal(_even()), _events(texts, stamps=stamps.tolist(), rate=10.0, kind="State")]


def _large_integers() -> list[bytes]:
    values = [[(1 << 62) + each, -(1 << 63) + each] for each in range(COUNT)]
    return [
        _signal(_even(), 3, "counts", values=values, fmt="int64", channels=2, kind="Counter"),
        _events(),
    ]


def _only_a_footer() -> list[bytes]:
    return [made.footer(1, 10)]


def _zero_samples() -> list[bytes]:
    return [_signal(_even(count=0), clock=[(1000.0, 0.5), (1005.0, 0.5)]), _events(())]


def _negative_rate() -> list[bytes]:
    header = _with_field(
        made.stream_header(1, "ecg", kind="ECG", rate=RATE), b"nominal_srate", b"-1.0"
    )
    return [header, _chunks(1, _even().tolist(), _wave(COUNT)), made.footer(1, COUNT), _events()]


def _nan_rate() -> list[bytes]:
    header = _with_field(
        made.stream_header(1, "ecg", kind="ECG", rate=RATE), b"nominal_srate", b"nan"
    )
    return [header, _chunks(1, _even().tolist(), _wave(COUNT)), made.footer(1, COUNT), _events()]


def _tiny_rate() -> list[bytes]:
    return [_signal(_even(rate=1e-5, count=40), rate=1e-5), _events()]


def _huge_rate() -> list[bytes]:
    return [_signal(_even(), rate=9e8), _events()]


ODD_TEXTS = (
    'say "no", then\tstop',
    '"not closed',
    "two\nlines\r\nand a third",
    "semi;colon",
    "=1+1",
    "",
    " \t ",
    "\x00\x01\x1b[31m",
    "Grüße 你好 🙂 \u202e",
    "n/a",
    "x" * 5000,
    '{"marker": "json", "n": 1}',
    "]]>&amp;<b>",
)


def _odd_texts() -> list[bytes]:
    return [_signal(_even()), _events(ODD_TEXTS)]


def _odd_names() -> list[bytes]:
    labels = ["a,b", 'say "x"', "tab\there", "two\nlines", "Grüße", "", "", "x" * 300]
    desc = _channels(labels, ["µV", "a\nb", "", "V", "°C", "x" * 300, "m/s^2", ","])
    name = 'Sensor\nzwei "Ä" / \\ : * ? <b> \t 🙂'
    return [
        _signal(_even(), 1, name, channels=8, kind="EEG\nmore", desc=desc, host="ho\nst"),
        _signal(_even(), 3, "", kind="", source_id=""),
        _signal(_even(), 4, "..", kind="EEG"),
        _signal(_even(), 5, "../../evil", kind="EEG"),
        _signal(_even(), 6, "README", kind="EEG"),
        _signal(_even(), 7, "participants", kind="EEG"),
        _events(name="Mar\nkers, ä"),
    ]


def _many_channels() -> list[bytes]:
    labels = ["EEG"] * 100 + ["Fp1"] * 100
    desc = _channels(labels)
    return [_signal(_even(count=520), kind="EEG", channels=200, desc=desc), _events()]


def _too_few_labels() -> list[bytes]:
    return [_signal(_even(), kind="EEG", channels=4, desc=_channels(["a", "b"])), _events()]


def _markers_first() -> list[bytes]:
    """The stream ended before the first marker."""
    return [_signal(_even(count=260)), _events(stamps=[1100.0, 1101.0, 1102.0])]


def _wrong_encoding(encoding: str, told: str) -> list[bytes]:
    text = _xml("utf-8", "Größe").decode().replace("utf-8", told)
    header = _raw_header(1, text.encode(encoding))
    return [header, _chunks(1, _even().tolist(), _wave(COUNT)), made.footer(1, COUNT), _events()]


def _with_mark() -> list[bytes]:
    header = _raw_header(1, b"\xef\xbb\xbf" + _xml("utf-8", "ecg"))
    return [header, _chunks(1, _even().tolist(), _wave(COUNT)), made.footer(1, COUNT), _events()]


def _lying_length(more: int) -> list[bytes]:
    chunk = made.samples(1, "float32", _wave(CHUNK), _even(begin=20.0, count=CHUNK).tolist())
    length = int.from_bytes(chunk[1:5], "little") + more
    lie = chunk[:1] + length.to_bytes(4, "little") + chunk[5:]
    return [_signal(_even(), ends=False), lie, made.boundary(), _events(), made.footer(1, COUNT)]


def _lying_count() -> list[bytes]:
    chunk = made.samples(1, "float32", _wave(CHUNK), _even(begin=20.0, count=CHUNK).tolist())
    lie = chunk.replace(b"\x04" + struct.pack("<I", CHUNK), b"\x04" + struct.pack("<I", 1 << 31))
    return [_signal(_even(), ends=False), lie, made.boundary(), _events(), made.footer(1, COUNT)]


def _one_offset() -> list[bytes]:
    return [_signal(_even(), clock=[(1003.0, 0.25)]), _events()]


def _no_offset() -> list[bytes]:
    return [_signal(_even(), clock=[]), _events()]


def _bad_offsets() -> list[bytes]:
    clock = [(np.nan, 0.0), (1003.0, np.inf), (1e308, -1e308), (0.0, 0.0), (1005.0, np.nan)]
    return [_signal(_even(), clock=clock), _events()]


def _huge_offsets() -> list[bytes]:
    clock = [(1000.0 + 5 * each, 1.7e9 * (each % 2)) for each in range(4)]
    return [_signal(_even(), clock=clock), _events()]


_YEARS_S = 1.7e9


def _clock_set(
    *, clock_s: float = 0.0, stamps_s: float = 0.0, offset_s: float = 0.0
) -> list[bytes]:
    """A stream whose clock is set in the middle.

    Parameters
    ----------
    clock_s, stamps_s
        By how much its clock, and its stamps, are set forward.
    offset_s
        By how much clock offsets differ without anything being set.
    """
    half, stamps, values = COUNT // 2, _even(), _wave(COUNT)
    stamps[half:] += stamps_s
    begin = [(BEGIN_S + each, 0.0) for each in (0.0, 2.0, 4.0, 6.0, 8.0)]
    end = [(at + 10 + clock_s, offset_s - clock_s) for at, _ in begin]
    return [
        made.stream_header(1, "ecg", kind="ECG", rate=RATE, source_id="id1"),
        *(made.clock_offset(1, *each) for each in begin),
        _chunks(1, stamps[:half].tolist(), values[:half]),
        *(made.clock_offset(1, *each) for each in end),
        _chunks(1, stamps[half:].tolist(), values[half:]),
        made.footer(1, COUNT),
        _events(),
    ]


def _offset_of_years() -> list[bytes]:
    clock = [(BEGIN_S + 2 * at, _YEARS_S * (at == 4)) for at in range(10)]
    return [_signal(_even(), clock=clock), _events()]


def _odd_values() -> list[bytes]:
    values: list[list[float]] = [[each, np.nan, np.inf, -1e308] for each in range(COUNT)]
    values[3][3] = 1e308
    return [
        _signal(_even(), values=values, fmt="double64", channels=4, kind="EEG"),
        _signal(_even(), 3, "nothing", values=[[np.nan]] * COUNT, kind="ECG"),
        _signal(_even(), 4, "none", values=[[5.0]] * COUNT, kind="GSR"),
        _events(),
    ]


def _left_out_stamps() -> list[bytes]:
    stamps: list[float | None] = [None] * COUNT
    header = made.stream_header(1, "ecg", kind="ECG", rate=RATE)
    return [header, _chunks(1, stamps, _wave(COUNT)), made.footer(1, COUNT), _events()]


def _same_header_twice() -> list[bytes]:
    header = made.stream_header(1, "ecg", kind="ECG", rate=RATE, source_id="id1")
    return [header, header, _signal(_even()), _events()]


def _samples_first() -> list[bytes]:
    """Samples stand before the header of their stream."""
    header = made.stream_header(1, "ecg", kind="ECG", rate=RATE, source_id="id1")
    body = _chunks(1, _even().tolist(), _wave(COUNT))
    return [body, header, body, made.footer(1, COUNT), _events()]


def _no_rate(jitter_s: float = 0.0, **header: Any) -> list[bytes]:
    stamps = _even() + np.random.default_rng(1).normal(0.0, 1.0, COUNT) * jitter_s
    return [_signal(stamps, rate=0.0, **header), _events()]


def _texts_only() -> list[bytes]:
    return [_events()]


def _one_of_each_count() -> list[bytes]:
    """Streams of one, two and three samples."""
    return [
        *(_signal(_even(count=each), each + 4, f"of {each}") for each in (1, 2, 3)),
        _events(("one",)),
    ]


def _slow_pulse() -> list[bytes]:
    values = [[0.8]] * 50
    stamps = BEGIN_S + np.cumsum(np.full(50, 0.8))
    return [_signal(stamps, values=values, kind="RR", rate=0.0, desc=_channels(["rr"], ["s"]))]


def _participants() -> list[bytes]:
    return [_signal(_even(), 1, "P1 ecg"), _signal(_even(), 3, "P1 ECG"), _events()]


def _stamps_in(unit_s: float) -> list[bytes]:
    """Stamps of a sender that does not count in seconds, beside some of one that does."""
    clock = [(BEGIN_S, 0.0), (BEGIN_S + 20.0, 0.0)]
    return [
        _signal(_even() / unit_s, clock=clock),
        _signal(_even(), 3, "eeg", kind="EEG"),
        _events(),
    ]


def _begun_again_unmeasured() -> list[bytes]:
    """The sender was started again, and the recorder measured no clock."""
    stamps = np.concatenate([_even(count=1300), 3.0 + np.arange(1300) / RATE])
    return [_signal(stamps, clock=[]), _events()]


def _recorded_again() -> list[bytes]:
    """The outlet was made again, so that its stream is in the file twice, one after the other."""
    return [
        _signal(_even(count=1300), source_id="same"),
        _signal(_even(begin=12.0, count=1040), 3, source_id="same"),
        _events(),
    ]


def _whole_numbers() -> list[bytes]:
    eight = [[each % 256 - 128] for each in range(COUNT)]
    sixteen = [[each * 37 % 65536 - 32768] for each in range(COUNT)]
    long = [[(1 << 40) + each] for each in range(COUNT)]
    return [
        _signal(_even(), 1, "bytes", values=eight, fmt="int8", kind="EEG"),
        _signal(_even(), 3, "words", values=sixteen, fmt="int16", kind="EEG"),
        _signal(_even(), 4, "long", values=long, fmt="int64", kind="EEG"),
        _events(),
    ]


def _two_of_one_name() -> list[bytes]:
    """Two streams of markers with one name, and numbers in one of them."""
    stamps = [BEGIN_S + each for each in (0.5, 1.6, 2.6)]
    numbers = (
        made.stream_header(3, "events", kind="Markers", fmt="int32"),
        made.samples(3, "int32", [[1], [2], [3]], stamps),
        made.footer(3, 3),
    )
    return [_signal(_even()), _events(), *numbers]


def _many_texts() -> list[bytes]:
    """Thousands of markers in half a second, many of them longer than EDF can have them."""
    texts = [f"{each} {'y' * (each % 300)}" for each in range(3000)]
    return [_signal(_even()), _events(texts, stamps=[BEGIN_S + 10 + k / 6000 for k in range(3000)])]


SEPARATORS = ("a\u2028b", "c\x85d", "e\x0bf", "g\x1ch", "i\x0cj", "k|l;m\tn", "\ufeffp", "q\r")


def _code_page() -> list[bytes]:
    """Header and marker of a program that sends the characters of Windows."""
    header = _raw_header(1, _xml("utf-8", "Größe").decode().encode("cp1252"))
    text = made.samples(2, "string", [["fuenf!"]], [BEGIN_S + 1]).replace(b"fuenf!", b"f\xfcnf!!")
    marker = made.stream_header(2, "events", kind="Markers", fmt="string") + text
    return [header, _chunks(1, _even().tolist(), _wave(COUNT)), made.footer(1, COUNT), marker]


def nameless(stamps: Array, chunk: int = CHUNK) -> list[bytes]:
    """Return the parts of a recording with a stream without a name."""
    clock = [(BEGIN_S, 0.0), (BEGIN_S + 20, 0.0)]
    return [_signal(stamps, name="", source_id="", clock=clock, chunk=chunk), _events()]


def _of_one_name() -> list[bytes]:
    """As some programs name all streams of a headband."""
    kinds = [("EEG", 256, 5), ("ACC", 52, 3), ("GYRO", 52, 3), ("PPG", 64, 3)]
    signals = [
        _signal(
            _even(rate=rate, count=20 * rate),
            number,
            "Muse",
            kind=kind,
            rate=float(rate),
            channels=channels,
            source_id="Muse1",
        )
        for number, (kind, rate, channels) in enumerate(kinds, 3)
    ]
    return [*signals, _events(name="Muse", source_id="Muse1")]


def _game_clock() -> list[bytes]:
    """A game stamps its markers with the seconds since it began."""
    begin_s = 500_000.0
    return [
        _signal(_even(begin=begin_s)),
        made.stream_header(2, "Game", kind="Markers", fmt="string", created_at=BEGIN_S + begin_s),
        made.samples(2, "string", [["cut 1"], ["cut 2"]], [3.5, 9.25]),
        made.offsets(2, (BEGIN_S + begin_s, BEGIN_S + begin_s + 20)),
        made.footer(2, 2),
    ]


Made = Callable[[], list[bytes]]

SHAPES: dict[str, Made] = {
    "stamps that decrease": _decreasing,
    "stamps in any order": _shuffled,
    "stamps that are all equal": _all_equal,
    "each stamp twice": _doubled,
    "stamps that are no number": _nan_stamps,
    "no stamp that is a number": _only_nan_stamps,
    "stamps beyond all clocks": _huge_stamps,
    "stamps as large as numbers are": _largest_stamps,
    "a gap of days": _days,
    "negative stamps": _negative_stamps,
    "no stamp at all": _left_out_stamps,
    "two streams of one uid": _one_uid,
    "two streams of one number": _one_number,
    "a stream of no channel": _no_channels,
    "texts with a rate": _texts_with_a_rate,
    "integers beyond 2**53": _large_integers,
    "only a footer": _only_a_footer,
    "nothing": list,
    "no sample, but clock offsets": _zero_samples,
    "a negative rate": _negative_rate,
    "a rate that is no number": _nan_rate,
    "a rate of days": _tiny_rate,
    "a rate of gigahertz": _huge_rate,
    "odd texts": _odd_texts,
    "odd names": _odd_names,
    "200 channels of two labels": _many_channels,
    "too few labels": _too_few_labels,
    "markers behind the end": _markers_first,
    "a header of Latin-1 that says UTF-8": lambda: _wrong_encoding("latin-1", "utf-8"),
    "a header of UTF-8 that says Latin-1": lambda: _wrong_encoding("utf-8", "latin-1"),
    "a header of UTF-8 that says UTF-16": lambda: _wrong_encoding("utf-8", "utf-16"),
    "a header of UTF-16": lambda: _wrong_encoding("utf-16", "utf-16"),
    "a header of an unknown encoding": lambda: _wrong_encoding("utf-8", "klingon"),
    "a byte order mark": _with_mark,
    "a chunk that is longer than it says": lambda: _lying_length(-100),
    "a chunk that is shorter than it says": lambda: _lying_length(100),
    "a chunk that says it is very long": lambda: _lying_length(1 << 31),
    "a chunk with fewer samples than it says": _lying_count,
    "one clock offset": _one_offset,
    "no clock offset": _no_offset,
    "clock offsets that are no number": _bad_offsets,
    "clock offsets of years": _huge_offsets,
    "clock offsets of years from the middle on": lambda: _clock_set(offset_s=_YEARS_S),
    "clock offsets of years before": lambda: _clock_set(offset_s=-_YEARS_S),
    "one clock offset of years": _offset_of_years,
    "a clock that was set to the date": lambda: _clock_set(clock_s=_YEARS_S, stamps_s=_YEARS_S),
    "a clock that was set to the date, and stamps that were not": lambda: _clock_set(
        clock_s=_YEARS_S
    ),
    "odd values": _odd_values,
    "volts without a unit": lambda: [
        _signal(_even(), values=[[2e-7 * value] for (value,) in _wave(COUNT)], fmt="double64"),
        _signal(_even(), 3, "nearly nothing", values=[[5e-324]] * COUNT, fmt="double64"),
        _events(),
    ],
    "a header twice": _same_header_twice,
    "samples before their header": _samples_first,
    "no rate": _no_rate,
    "no rate, and jitter": lambda: _no_rate(0.002),
    "no rate, EEG": lambda: _no_rate(0.0, kind="EEG"),
    "no rate, and irregular": lambda: _no_rate(2.0, kind="EEG"),
    "only texts": _texts_only,
    "very few samples": _one_of_each_count,
    "only intervals": _slow_pulse,
    "names that differ by case": _participants,
    "stamps from before 0": lambda: [
        _signal(_even() - 1010.0),
        _events(stamps=[-9.5, -8.5, 1.0]),
    ],
    "stamps in milliseconds": lambda: _stamps_in(1e-3),
    "stamps in microseconds": lambda: _stamps_in(1e-6),
    "twice the rate": lambda: [_signal(_even(), rate=2 * RATE), _events()],
    "half the rate": lambda: [_signal(_even(), rate=RATE / 2), _events()],
    "a clock that began again, unmeasured": _begun_again_unmeasured,
    "a stream that was recorded again": _recorded_again,
    "whole numbers": _whole_numbers,
    "two streams of markers of one name": _two_of_one_name,
    "very many markers": _many_texts,
    "odd separators": lambda: [_signal(_even()), _events(SEPARATORS)],
    "markers in no order": lambda: [
        _signal(_even()),
        _events(stamps=[BEGIN_S + each for each in (3.0, 1.0, 2.0)]),
    ],
    "characters of Windows": _code_page,
    "a stream without a name": lambda: nameless(_even()),
    "five streams of one name": _of_one_name,
    "markers on a clock of their own": _game_clock,
    "a unit that is not ASCII": lambda: [
        _signal(_even(), desc=_channels(["lead"], ["µV"])),
        _events(),
    ],
}


def content(shape: str) -> bytes:
    """Return the bytes of a recording of a shape."""
    return made.xdf(*SHAPES[shape]())


def files() -> dict[str, tuple[str, bytes]]:
    """Return name and bytes of each: the shapes, and some in other files than plain ones."""
    found = {shape: (f"rec {at:02}.xdf", content(shape)) for at, shape in enumerate(SHAPES)}
    whole = made.xdf(_signal(_even()), _events())
    found["packed"] = ("packed.xdf.gz", gzip.compress(whole))
    found["packed, as SigViewer names it"] = ("packed.xdfz", gzip.compress(whole))
    found["packed and cut off"] = ("cut.xdf.gz", gzip.compress(whole)[:-4000])
    found["packed though its name does not say it"] = ("hidden.xdf", gzip.compress(whole))
    found["plain though its name says packed"] = ("plain.xdf.gz", whole)
    found["a byte order mark before all"] = ("mark.xdf", b"\xef\xbb\xbf" + whole)
    second = (_signal(_even(begin=30.0), name="b", kind="EEG"), _events(("later",), stamps=[1031]))
    found["two recordings in one"] = ("joined.xdf", whole + made.xdf(*second))
    found["zeros behind the end"] = ("zeros.xdf", whole + bytes(5000))
    found["cut off"] = ("cut.xdf", whole[:-3333])
    found["empty"] = ("empty.xdf", b"")
    found["only the magic"] = ("magic.xdf", b"XDF:")
    found["a text"] = ("text.xdf", b"hello there, this is no recording\n")
    found["umlauts in its name"] = ("Größe P07 (1).xdf", whole)
    return found
