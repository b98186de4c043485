"""What comes from the process that reads a board, in any pieces, and when it is none of it."""

from __future__ import annotations

import struct
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.brainflow.driver.emitter import Frames, Rows, Told


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
    with pytest.raises(ProtocolError, match="started again"):
        list(Frames().feed(bad))
