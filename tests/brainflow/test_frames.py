"""What comes from the process that reads a board, and the packet numbers in it."""

from __future__ import annotations

import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.brainflow.driver.emitter import (
    Frames,
    PresetEmitter,
    Rows,
    SampleCount,
    Told,
)
from tests.rigs.emitter_sink import EmitterSink

# What comes from the process that reads a board, in any pieces, and when it is none of it.


def frame(kind: bytes, preset: int, content: bytes) -> bytes:
    return kind + struct.pack("<BI", preset, len(content)) + content


VALUES = np.arange(12.0).reshape(3, 4)
SENT = (
    frame(b"J", 0, b'{"started": true}')
    + frame(b"S", 1, struct.pack("<dI", 1.5, 3) + VALUES.tobytes())
    + frame(b"B", 0, b"")
)


@given(st.lists(st.integers(1, len(SENT) - 1), max_size=20))
def test_any_pieces_give_the_same(cuts: list[int]) -> None:
    edges = [0, *sorted(cuts), len(SENT)]
    frames = Frames()
    found = [each for begin, end in pairwise(edges) for each in frames.feed(SENT[begin:end])]
    started, rows, beat = found
    assert (started, beat) == (Told({"started": True}), Told({}))
    assert isinstance(rows, Rows)
    assert (rows.preset, rows.now_s) == (1, 1.5)
    np.testing.assert_array_equal(rows.values, VALUES)


@given(st.binary(max_size=200))
def test_no_bytes_are_anything_but_frames_or_one_reason(data: bytes) -> None:
    try:
        list(Frames().feed(data))
    except ProtocolError as error:
        assert error.reason is ProtocolReason.GARBAGE


@pytest.mark.parametrize(
    "bad",
    [
        b"Traceback (most recent call last)",
        frame(b"J", 0, b"[1]"),
        frame(b"J", 0, b"not json"),
        frame(b"S", 0, struct.pack("<dI", 1.0, 0)),
        frame(b"S", 0, struct.pack("<dI", 1.0, 5) + bytes(8)),
        frame(b"S", 0, b"short"),
    ],
)
def test_what_is_no_frame_is_said(bad: bytes) -> None:
    with pytest.raises(ProtocolError, match="restarted"):
        list(Frames().feed(bad))


# Packet numbers of boards that count, and of those that do not.
@given(
    turn=st.sampled_from([201, 256]),
    first=st.integers(0, 200),
    lost=st.sets(st.integers(1, 998)),
    cuts=st.lists(st.integers(1, 60), min_size=30, max_size=60),
)
def test_what_is_missing_is_counted_and_keeps_its_place(
    turn: int, first: int, lost: set[int], cuts: list[int]
) -> None:
    kept = np.array([place for place in range(1000) if place not in lost])
    # More than a turn in a row cannot be seen in the number.
    if np.diff(kept).max() >= turn:
        return
    count = SampleCount(turn)
    places: list[int] = []
    missing = 0
    begin = 0
    for cut in [*cuts, 1000]:
        part = kept[begin : begin + cut]
        begin += cut
        if len(part):
            found, gone = count.place(((first + part) % turn).astype(np.float64))
            places += found.tolist()
            missing += gone
    assert places == kept.tolist()
    assert missing == 1000 - len(kept) - (999 - kept[-1])


@pytest.mark.parametrize("numbers", [[5.0, 5.0, 5.0, 5.0], [9.0, 1.0, 700.0, 3.0]])
def test_a_board_that_counts_nothing_loses_nothing(numbers: list[float]) -> None:
    places, missing = SampleCount(0).place(np.array(numbers))
    assert places.tolist() == [0, 1, 2, 3]
    assert missing == 0


@pytest.mark.parametrize(("true_hz", "is_said"), [(200.0, True), (251.0, False)])
def test_another_rate_than_the_declared_one_is_shown_and_not_only_logged(
    true_hz: float, is_said: bool
) -> None:
    sink = EmitterSink("polar_h10")
    where = {"timestamp_channel": 0, "package_num_channel": 1, "num_rows": 2}
    emitter = PresetEmitter((), where, 250.0, 256, sink, sink)
    for second in range(25):
        numbers = np.arange(second * true_hz, (second + 1) * true_hz)
        values = np.stack([numbers / true_hz, numbers % 256])
        emitter.take(Rows(0, float(values[0, -1]), values), 1000 + float(values[0, -1]))
    said = [*sink.watch.remarks.values()]
    assert any("200.0 samples a second and 250 are declared" in each for each in said) == is_said
