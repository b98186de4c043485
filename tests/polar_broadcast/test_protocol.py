"""Advertised heart rates, against vectors and against any bytes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.polar_broadcast.driver.protocol import COUNTS, parse

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors" / "advertisements.json").read_text(encoding="utf-8")
)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_vector(vector: dict[str, Any]) -> None:
    broadcast = parse(bytes.fromhex(vector["hex"]))
    assert broadcast is not None
    assert broadcast._asdict() == vector["expected"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "33",
        "3300",
        # Longer than any that is known.
        "3300003838",
        # Nothing but blocks of other kinds, the last one cut short.
        "7208" + 8 * "00",
        "7208" + 3 * "00",
        "72",
        "720072",
    ],
)
def test_where_no_heart_rate_is_there_is_none(text: str) -> None:
    assert parse(bytes.fromhex(text)) is None


@given(st.binary(max_size=31))
def test_any_bytes_are_a_possible_rate_or_none(data: bytes) -> None:
    broadcast = parse(data)
    if broadcast is not None:
        assert 0 <= broadcast.counter < COUNTS
        assert broadcast.bpm in data
        assert len(data) >= 3
