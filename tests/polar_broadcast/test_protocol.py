"""Advertised heart rates, against vectors and against any bytes."""

from __future__ import annotations

import asyncio
import json
from contextlib import AsyncExitStack, ExitStack
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.polar_broadcast.driver.protocol import COUNTS, parse
from biosensor_gateway.devices.polar_broadcast.simulator import SimulatedPolarBroadcast
from biosensor_gateway.simulation.radio import Radio, Transceiver
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import Run, streaming

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


STRAPS = 100
INTERVAL_MS = 250.0
MISSED = 0.3
SECONDS = 16.0
OLD_S = 2.0
FRESH = 0.99


def ages_s(strap: SimulatedPolarBroadcast, run: Run, until_s: float) -> np.ndarray:
    """Return how old the newest rate is, at each of many moments from the third one on."""
    arrivals = np.array(run.sink.times["hr"])
    measured = strap.truth.samples("hr").times
    # What is advertised at any moment is what was measured last.
    of_arrivals = measured[np.searchsorted(measured, arrivals, side="right") - 1]
    moments = np.arange(arrivals[2], until_s, 0.05)
    return moments - of_arrivals[np.searchsorted(arrivals, moments, side="right") - 1]


@ON_BUMBLE
async def test_of_a_hundred_straps_the_rate_is_hardly_ever_older_than_two_seconds(
    radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    chance = Random(1)
    hear = Transceiver.on_advertising_pdu

    def hear_most(transceiver: Transceiver, pdu: object) -> None:
        if chance.random() >= MISSED:
            hear(transceiver, pdu)  # pyright: ignore[reportArgumentType] - as it comes

    monkeypatch.setattr(Transceiver, "on_advertising_pdu", hear_most)
    straps = [
        SimulatedPolarBroadcast(
            radio.world,
            radio,
            address=f"A0:9E:1A:00:00:{number:02X}",
            device_id=f"C1A550{number:02X}",
            interval_ms=INTERVAL_MS,
            seed=number,
        )
        for number in range(STRAPS)
    ]
    async with AsyncExitStack() as runs:
        with ExitStack() as worn:
            for strap in straps:
                worn.enter_context(strap)
            all_runs = [await runs.enter_async_context(streaming(strap)) for strap in straps]
            # In the world's time.
            await asyncio.sleep(SECONDS)
            until_s = radio.world.clock()
    ages = np.concatenate(
        [ages_s(strap, run, until_s) for strap, run in zip(straps, all_runs, strict=True)]
    )
    assert np.mean(ages <= OLD_S) >= FRESH, (
        f"{np.mean(ages <= OLD_S):.2%}, oldest {ages.max():.1f} s"
    )
    for strap, run in zip(straps, all_runs, strict=True):
        assert run.supervisor.connections == 1
        measured = strap.truth.samples("hr").times
        first_s, last_s = run.sink.times["hr"][0], run.sink.times["hr"][-1]
        # The one that was heard first was measured just before.
        count = np.count_nonzero((measured > first_s) & (measured <= last_s)) + 1
        assert len(run.sink.rows["hr"]) + run.sink.lost_count("hr") == count
