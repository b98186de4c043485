"""Framing: nothing raises, hangs, grows or goes missing uncounted, whatever the bytes."""

from __future__ import annotations

import tracemalloc
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from itertools import pairwise
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_gateway.devices.zephyr.driver.messages import (
    Lifesign,
    Message,
    Reply,
    RrIntervals,
    Unknown,
)
from biosensor_gateway.devices.zephyr.driver.protocol import (
    LIFESIGN,
    Frame,
    FrameParser,
    MessageId,
    Terminator,
    ZephyrProtocol,
    crc8,
    request,
)

_WHOLE = "zephyr_bh3_2012-09-26_150s.dat"
_WITH_GAP = "zephyr_bh3_2012-04-06_with_gap.dat"
_REPLIES = dict.fromkeys((0x15, 0x16, 0x19, 0x1E, 0xBD), 1)
_PACKETS = {0x21: 149, 0x22: 597, 0x23: 50, 0x24: 150, 0x25: 376, 0x2B: 150, 0x2C: 2}
_SIZES: dict[int, Sequence[int]] = {
    0x20: [53],
    0x21: [32],
    0x22: [88],
    0x23: [0],
    0x24: [45],
    0x25: [84],
    0x2A: [84],
    0x2B: [71],
    0x2C: range(11, 32),
}
_ANY_SIZE = range(129)
_LONGEST_PARTIAL_FRAME = 128 + 4
_HEADER = bytes.fromhex("01ea07011f18572605")
_ECG = request(MessageId.ECG, _HEADER + bytes(79))
_RR = request(MessageId.RR, _HEADER + bytes(36))


@cache
def _recording(name: str) -> bytes:
    package = files("biosensor_gateway.devices.zephyr")
    return package.joinpath("simulator", "recordings", name).read_bytes()


def _encode(frame: Frame) -> bytes:
    return request(frame.message_id, frame.payload)[:-1] + bytes((frame.terminator,))


def _size(frames: Iterable[Frame]) -> int:
    return sum(len(_encode(frame)) for frame in frames)


def _reference_crc(payload: bytes) -> int:
    """Shift bits through the polynomial one by one, as the vendor describes it."""
    crc = 0
    for byte in payload:
        for number in range(8):
            carry = (crc ^ byte >> number) & 1
            crc = crc >> 1 ^ (0x8C if carry else 0)
    return crc


@st.composite
def _any_frame(draw: st.DrawFn) -> Frame:
    message_id = draw(st.one_of(st.sampled_from(MessageId), st.integers(0, 255)))
    size = draw(st.sampled_from(_SIZES.get(message_id, _ANY_SIZE)))
    payload = draw(st.binary(min_size=size, max_size=size))
    return Frame(int(message_id), payload, draw(st.sampled_from(Terminator)))


def _recorded_slice(start: int, length: int) -> bytes:
    return _recording(_WHOLE)[start : start + length]


def _noise(seed: int, size: int) -> bytes:
    return Random(seed).randbytes(size)


def _repeat(block: bytes, count: int) -> bytes:
    return block * count


_PREFIXES = (b"\x02", b"\x02\x22\x58", b"\x02\x2b\x47", b"\x02\x77\x80", b"\x02\x23\x00")
_GARBAGE = st.one_of(
    st.binary(max_size=64),
    st.builds(_noise, st.integers(0, 2**32), st.integers(0, 10_000)),
    st.builds(
        _repeat, st.one_of(st.sampled_from(_PREFIXES), st.binary(max_size=8)), st.integers(0, 999)
    ),
)
_SLICE = st.builds(_recorded_slice, st.integers(0, 110_000), st.integers(0, 1500))
_STREAM = st.lists(st.one_of(_SLICE, _GARBAGE, _any_frame().map(_encode)), max_size=6).map(b"".join)


def _pieces(stream: bytes, cuts: Iterable[int]) -> list[bytes]:
    ends = sorted(min(cut, len(stream)) for cut in cuts)
    return [stream[start:end] for start, end in pairwise((0, *ends, len(stream)))]


def _messages(pieces: Iterable[bytes]) -> tuple[list[Message], int, int]:
    protocol = ZephyrProtocol()
    messages = [message for piece in pieces for message in protocol.feed(piece)]
    return messages, protocol.dropped_bytes, protocol.buffered


@settings(deadline=None)
@given(st.binary(max_size=128))
def test_crc_is_the_reflected_polynomial_8c(payload: bytes) -> None:
    assert crc8(payload) == _reference_crc(payload)


@pytest.mark.parametrize(("name", "count", "dropped"), [(_WHOLE, 1479, 0), (_WITH_GAP, 1157, 39)])
def test_recording_gives_every_frame_and_counts_the_rest(
    name: str, count: int, dropped: int
) -> None:
    parser = FrameParser()
    frames = parser.feed(_recording(name))
    assert (len(frames), parser.dropped_bytes) == (count, dropped)
    assert _size(frames) + dropped + parser.buffered == len(_recording(name))


def test_recording_holds_the_packets_that_were_enabled() -> None:
    counts = Counter(frame.message_id for frame in FrameParser().feed(_recording(_WHOLE)))
    assert counts == _PACKETS | _REPLIES


@settings(deadline=None)
@given(st.lists(_any_frame(), max_size=12))
def test_frames_without_garbage_come_back_as_they_were(frames: list[Frame]) -> None:
    stream = b"".join(map(_encode, frames))
    parser = FrameParser()
    assert parser.feed(stream) == frames
    assert (parser.dropped_bytes, parser.buffered) == (0, 0)
    assert len(ZephyrProtocol().feed(stream)) == len(frames)


@settings(deadline=None)
@given(_any_frame(), st.binary(max_size=600), st.binary(max_size=600))
def test_garbage_without_a_start_byte_costs_nothing_but_itself(
    frame: Frame, before: bytes, after: bytes
) -> None:
    before, after = before.replace(b"\x02", b"\x00"), after.replace(b"\x02", b"\x00")
    parser = FrameParser()
    assert parser.feed(before + _encode(frame) + after) == [frame]
    assert parser.dropped_bytes == len(before) + len(after)


@pytest.mark.parametrize("message_id", _SIZES)
def test_a_length_that_does_not_fit_the_id_is_rejected(message_id: int) -> None:
    for size in set(_ANY_SIZE) - set(_SIZES[message_id]):
        protocol = ZephyrProtocol()
        messages = protocol.feed(request(message_id, bytes(size)) + LIFESIGN) + protocol.give_up()
        assert [item for item in messages if not isinstance(item, Unknown)] == [Lifesign()]


@pytest.mark.parametrize("end", sorted(set(range(256)) - set(Terminator)))
def test_any_other_end_is_rejected(end: int) -> None:
    parser = FrameParser()
    assert parser.feed(LIFESIGN[:-1] + bytes((end,))) == []
    assert parser.dropped_bytes + parser.buffered == len(LIFESIGN)


@pytest.mark.parametrize("count", range(1, 20))
def test_start_bytes_before_a_frame_are_all_that_is_dropped(count: int) -> None:
    parser = FrameParser()
    frames = parser.feed(b"\x02" * count + _ECG)
    assert [_encode(frame) for frame in frames][-1:] == [_ECG]
    assert parser.dropped_bytes + _size(frames) == count + len(_ECG)


@pytest.mark.parametrize("message_id", [0x27, 0x28, 0x3F, 0x60, 0xBC])
def test_an_unknown_frame_is_skipped_by_its_length(message_id: int) -> None:
    messages, dropped, _ = _messages([request(message_id, LIFESIGN * 20) + LIFESIGN])
    assert (messages, dropped) == ([Unknown(message_id), Lifesign()], 0)


def test_a_huge_read_needs_no_huge_buffer() -> None:
    read = bytes(1_000_000)
    tracemalloc.start()
    FrameParser().feed(read)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50_000


@pytest.mark.parametrize("name", [_WHOLE, _WITH_GAP])
def test_a_recording_fed_byte_by_byte_decodes_the_same(name: str) -> None:
    recording = _recording(name)
    single_bytes = (recording[at : at + 1] for at in range(len(recording)))
    assert _messages(single_bytes) == _messages([recording])


@settings(deadline=None, max_examples=200)
@given(_STREAM, st.lists(st.integers(0, 8000), max_size=40))
def test_chunking_changes_neither_messages_nor_counts(stream: bytes, cuts: list[int]) -> None:
    assert _messages(_pieces(stream, cuts)) == _messages([stream])


@settings(deadline=None, max_examples=200)
@given(_STREAM, st.lists(st.integers(0, 40_000), max_size=20))
def test_any_bytes_are_accounted_for_at_every_moment(stream: bytes, cuts: list[int]) -> None:
    parser, protocol = FrameParser(), ZephyrProtocol()
    fed = framed = 0
    for piece in _pieces(stream, cuts):
        fed += len(piece)
        framed += _size(parser.feed(piece))
        protocol.feed(piece)
        assert fed == framed + parser.dropped_bytes + parser.buffered
        assert parser.buffered <= _LONGEST_PARTIAL_FRAME
    assert (protocol.dropped_bytes, protocol.buffered) == (parser.dropped_bytes, parser.buffered)
    framed += _size(parser.give_up())
    assert (framed + parser.dropped_bytes, parser.buffered) == (fed, 0)


@pytest.mark.parametrize(
    "block",
    [
        *_PREFIXES,
        *[b"\x02\x22\x58\x03", b"\x02\x80\x80", b"\x02\x7f\x7f\x02", b"\x02\x23"],
        *[b"\x02\xff\xff", _ECG[:-1], _ECG[:40], LIFESIGN[:-1], b"\x00", b"\x03"],
    ],
    ids=lambda block: block[:8].hex(),
)
def test_a_long_run_of_almost_frames_is_survived(block: bytes) -> None:
    run = (block * 40_000)[:40_000]
    messages, dropped, buffered = _messages([run])
    assert not any(isinstance(message, Lifesign | RrIntervals) for message in messages)
    assert buffered <= _LONGEST_PARTIAL_FRAME
    assert dropped <= len(run)
    # A false start can hide a frame, but not for longer than the longest frame lasts.
    after = _messages([run, _RR * 5])[0][len(messages) :]
    assert sum(isinstance(message, RrIntervals) for message in after) >= 2


def test_a_lost_byte_costs_at_most_its_frame_and_the_next() -> None:
    recorded = FrameParser().feed(_recording(_WHOLE))
    known = {frame.message_id for frame in recorded}
    for first in range(len(recorded)):
        frames = recorded[first : first + 5]
        stream = b"".join(map(_encode, frames))
        for at in range(len(_encode(frames[0]))):
            parser = FrameParser()
            decoded = parser.feed(stream[:at] + stream[at + 1 :]) + parser.give_up()
            left = [frame for frame in decoded if frame.message_id in known]
            assert left in (frames[1:], frames[2:]), f"byte {at} of frame {first}"


@pytest.mark.parametrize("message_id", [*_PACKETS, *_REPLIES])
def test_no_flipped_bit_makes_another_data_packet(message_id: int) -> None:
    recorded = FrameParser().feed(_recording(_WITH_GAP))
    frames = [frame for frame in recorded if frame.message_id == message_id][:4]
    harmless = Unknown if message_id in _PACKETS else Unknown | Reply
    assert frames
    for original in map(_encode, frames):
        for bit in range(8 * len(original)):
            flipped = bytearray(original)
            flipped[bit // 8] ^= 1 << bit % 8
            protocol = ZephyrProtocol()
            *others, last = protocol.feed(bytes(flipped) + LIFESIGN) + protocol.give_up()
            assert last == Lifesign(), f"bit {bit}"
            assert all(isinstance(other, harmless) for other in others), f"bit {bit}"


def test_giving_up_releases_what_a_torn_frame_hid() -> None:
    torn = _ECG[:10]
    protocol = ZephyrProtocol()
    acknowledgement = bytes.fromhex("0216000006")
    assert protocol.feed(torn + LIFESIGN + acknowledgement) == []
    assert protocol.buffered == len(torn) + 10
    assert protocol.give_up() == [Lifesign(), Reply(0x16, accepted=True, data=b"")]
    assert (protocol.dropped_bytes, protocol.buffered) == (len(torn), 0)
    assert protocol.feed(LIFESIGN) == [Lifesign()]
    assert protocol.dropped_bytes == len(torn)


@pytest.mark.parametrize("torn", [b"", _ECG[:1], _ECG[:-1]])
def test_giving_up_drops_a_torn_frame_that_hid_nothing(torn: bytes) -> None:
    protocol = ZephyrProtocol()
    assert protocol.feed(torn) + protocol.give_up() == []
    assert (protocol.dropped_bytes, protocol.buffered) == (len(torn), 0)


@pytest.mark.parametrize("cut", range(1, len(_ECG)))
def test_a_frame_torn_anywhere_hides_the_next_at_most_until_given_up(cut: int) -> None:
    protocol = ZephyrProtocol()
    messages = protocol.feed(_ECG[:cut] + LIFESIGN) + protocol.give_up()
    assert messages == [Lifesign()]
    assert protocol.dropped_bytes == cut
