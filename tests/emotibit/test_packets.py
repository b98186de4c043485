"""Lines of text, against vectors and against any bytes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.emotibit.driver.protocol import NUMBERS, TIMES_MS, Tag, read, write

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/emotibit_packets.json").read_text(encoding="utf-8")
)
REAL = "".join(each["text"] for each in VECTORS if each["name"].startswith("real_")).encode()


@pytest.mark.parametrize("vector", VECTORS, ids=[each["name"] for each in VECTORS])
def test_a_datagram_is_read_as_it_was_meant(vector: dict[str, Any]) -> None:
    found = read(vector["text"].encode())
    told = [
        {
            "time_ms": each.time_ms,
            "number": each.number,
            "tag": each.tag,
            "values": None if each.values() is None else list(each.values() or ()),
        }
        for each in found.packets
    ]
    assert told == vector["expected"]
    assert found.dropped_bytes == vector["dropped_bytes"]


def test_labels_are_found_wherever_they_stand() -> None:
    (packet,) = read(b"1,2,4,HH,1,100,DP,-1,DI,MD-V5-0000123\n").packets
    assert (packet.labelled("DI"), packet.labelled("DP")) == ("MD-V5-0000123", "-1")
    assert packet.labelled("-1") is None


@given(
    st.sampled_from(Tag),
    st.integers(0, 2 * NUMBERS),
    st.lists(st.from_regex(r"[A-Za-z0-9.\-]{0,12}", fullmatch=True), max_size=8),
    st.integers(0, TIMES_MS - 1),
)
def test_what_is_written_is_read(tag: Tag, number: int, payload: list[str], time_ms: int) -> None:
    found = read(write(tag, number, payload, time_ms))
    assert found.packets == [(time_ms, number % NUMBERS, tag, tuple(payload))]
    assert found.dropped_bytes == 0


@given(st.integers(0, len(REAL) - 1), st.integers(0, 255))
def test_a_wrong_byte_costs_no_more_than_its_line(at: int, byte: int) -> None:
    damaged = REAL[:at] + bytes([byte]) + REAL[at + 1 :]
    good = set(read(REAL).packets)
    assert len(good - set(read(damaged).packets)) <= 2


@given(st.integers(0, len(REAL)))
def test_of_a_cut_datagram_whole_lines_are_kept(at: int) -> None:
    whole = read(REAL[: REAL.rfind(b"\n", 0, at) + 1]).packets
    assert read(REAL[:at]).packets[: len(whole)] == whole


@given(st.binary(max_size=300))
def test_any_bytes_are_read(data: bytes) -> None:
    found = read(data)
    assert 0 <= found.dropped_bytes <= len(data)
    for packet in found.packets:
        assert packet.number < NUMBERS
        assert packet.time_ms < TIMES_MS
        packet.values()
