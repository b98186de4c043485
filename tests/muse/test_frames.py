"""Frames of an Athena, against vectors, cuts and any bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.muse.driver.frames import (
    Block,
    Kind,
    charge_counts,
    eeg_uv,
    light,
    motion,
    parse_notification,
)
from tests.muse.known import VECTORS, bytes_of, of_kind

WHOLE = [bytes_of(each) for each in VECTORS if each["kind"] == "frame" and each["expected"]]


def samples_of(block: Block) -> np.ndarray[Any, Any] | None:
    match block.kind:
        case Kind.EEG4 | Kind.EEG8:
            return eeg_uv([block])
        case Kind.LIGHT4 | Kind.LIGHT8 | Kind.LIGHT16:
            return light([block])
        case Kind.MOTION:
            return np.concatenate(motion([block]), axis=1)
        case _:
            return None


@of_kind("frame")
def test_a_frame_is_read_as_its_vector_says(vector: dict[str, Any]) -> None:
    data, expected = bytes_of(vector), vector["expected"]
    frames, unread = parse_notification(data)
    if expected is None:
        assert (frames, unread) == ([], len(data))
        return
    (frame,) = frames
    assert (frame.counter, unread) == (expected["counter"], expected["unread"])
    assert [each.kind.name for each in frame.blocks] == [
        each["kind"] for each in expected["blocks"]
    ]
    for block, known in zip(frame.blocks, expected["blocks"], strict=True):
        assert block.number == known["number"]
        assert round(1e6 * block.stamp_s) == known["stamp_us"]
        if "samples" in known:
            samples = samples_of(block)
            assert samples is not None
            np.testing.assert_allclose(samples, known["samples"], rtol=1e-12)
        if "charge" in known:
            assert charge_counts(block) == known["charge"]


def test_several_frames_of_a_notification_are_read_alike() -> None:
    alone = [parse_notification(data) for data in WHOLE]
    frames, unread = parse_notification(b"".join(WHOLE))
    assert frames == [frame for found, _ in alone for frame in found]
    assert unread == sum(each for _, each in alone)


def test_a_frame_that_is_cut_costs_itself_alone() -> None:
    for cut in range(1, len(WHOLE[1])):
        frames, unread = parse_notification(WHOLE[0] + WHOLE[1][:-cut])
        assert frames == parse_notification(WHOLE[0])[0]
        assert unread == len(WHOLE[1]) - cut


@given(st.binary(max_size=300))
def test_any_bytes_are_read_to_the_last_or_counted(data: bytes) -> None:
    frames, unread = parse_notification(data)
    read = sum(9 + sum(5 + len(block.payload) for block in frame.blocks) for frame in frames)
    assert read + unread == len(data)
    for frame in frames:
        for block in frame.blocks:
            samples = samples_of(block)
            assert samples is None or np.isfinite(samples).all()


@given(st.sampled_from(WHOLE), st.data())
def test_a_byte_that_is_flipped_or_missing_raises_nothing(
    whole: bytes, data: st.DataObject
) -> None:
    at = data.draw(st.integers(0, len(whole) - 1))
    flipped = bytearray(whole)
    flipped[at] ^= 1 << data.draw(st.integers(0, 7))
    for broken in (bytes(flipped), whole[:at] + whole[at + 1 :]):
        frames, unread = parse_notification(broken)
        assert 0 <= unread <= len(broken)
        assert len(frames) <= 1
