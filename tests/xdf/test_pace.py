"""Stamps of other programs: bursts, overlaps and stalls are no gaps, and lost samples are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.pace import Cuts, find_pace
from tests.xdf import xdf_file as made
from tests.xdf.checking import check, codes, text_of

Array = NDArray[np.float64]

NOMINAL_HZ, REAL_HZ = 130.0, 129.8
BURST = 73
COUNT = 200 * BURST
# As a sender's radio delays what it sends.
DELAY_S = 0.03


def measured(count: int = COUNT) -> Array:
    return 1000.0 + np.arange(count) / REAL_HZ


def delays(count: int, seed: int = 1) -> Array:
    return np.random.default_rng(seed).exponential(DELAY_S, count)


def bursts(delay: Array) -> Array:
    """Stamps of samples that are stamped when their packet comes."""
    return np.repeat(measured(len(delay) * BURST)[BURST - 1 :: BURST] + delay, BURST)


def overlaps(delay: Array) -> Array:
    """Stamps that a sender has counted back from when a packet came, by the nominal rate."""
    return bursts(delay) - np.tile(np.arange(BURST)[::-1] / NOMINAL_HZ, len(delay))


def without(stamps: Array, places: Sequence[int], lost: int) -> Array:
    return np.delete(stamps, [place + each for place in places for each in range(lost)])


def stalled(stamps: Array, at: int, held_s: float) -> Array:
    """Hold samples up, so that they come all at once."""
    release = stamps[at] + held_s
    return np.where(np.arange(len(stamps)) >= at, np.maximum(stamps, release), stamps)


HARMLESS = {
    "exact": measured(),
    "each delayed": measured() + delays(COUNT),
    "bursts": bursts(np.zeros(200)),
    "delayed bursts": bursts(delays(200)),
    "overlaps": overlaps(delays(200)),
    "a stall": stalled(measured() + delays(COUNT) / 10, 5000, 2.0),
    "a stall of bursts": stalled(bursts(delays(200)), 50 * BURST, 3.0),
    "a fast clock": measured() * 1.001 + delays(COUNT),
    "few": measured(10),
    "a few bursts": bursts(delays(3)),
}


@pytest.mark.parametrize("name", HARMLESS)
def test_where_nothing_is_lost_nothing_is_told(name: str) -> None:
    stamps = HARMLESS[name]
    found = find_pace(stamps, NOMINAL_HZ)
    assert found.cuts == ()
    if len(stamps) == COUNT:
        clock = 1.001 if name == "a fast clock" else 1.0
        assert 1 / found.period_s == pytest.approx(REAL_HZ / clock, rel=1e-3)
    assert found.burst == (BURST if "bursts" in name else 1)
    assert (found.overlap_s > 0) == bool((np.diff(stamps) < 0).any())


LOSSES = {
    "one sample": (measured(), [1000, 5000, 9000], 1),
    "many holes": (measured(), list(range(500, 14000, 300)), 20),
    "twenty of delayed ones": (measured() + delays(COUNT) / 10, [1000, 5000, 5100], 20),
    "a burst": (bursts(delays(200) / 10), [50 * BURST, 120 * BURST], BURST),
    "three bursts": (bursts(delays(200)), [50 * BURST], 3 * BURST),
    "a minute": (measured(), [4000], 7788),
}


@pytest.mark.parametrize("name", LOSSES)
def test_what_is_lost_is_counted_where_it_was(name: str) -> None:
    stamps, places, lost = LOSSES[name]
    found = find_pace(without(stamps, places, lost), NOMINAL_HZ)
    expected = [place - number * lost for number, place in enumerate(places)]
    assert [each.at for each in found.holes] == expected
    # As exactly as the stamps around it tell.
    counted = [each.lost for each in found.holes]
    assert counted == pytest.approx([lost] * len(places), abs=max(0.02 * lost, 0.1) + 1)
    assert 1 / found.period_s == pytest.approx(REAL_HZ, rel=2e-3)


def test_a_rate_in_the_header_may_be_wrong() -> None:
    found = find_pace(1000.0 + np.arange(300.0), 44100.0)
    assert (found.period_s, found.holes) == (pytest.approx(1.0), ())


def test_a_clock_that_was_set_back_is_a_turn_and_nothing_is_lost() -> None:
    stamps = measured()
    stamps[5000:] -= 100.0
    found = find_pace(stamps, NOMINAL_HZ)
    assert (found.turns, found.holes, found.odd_steps_back) == ((5000,), (), 1)
    assert 1 / found.period_s == pytest.approx(REAL_HZ)


@pytest.mark.parametrize("away_s", [200_000.0, -19.0])
def test_a_stamp_that_is_no_time_ends_no_run(away_s: float) -> None:
    stamps = measured()
    stamps[3900] += away_s
    found = find_pace(stamps, NOMINAL_HZ)
    assert (found.stray, found.cuts, found.odd_steps_back) == ((3900,), (), 0)


def test_garbage_behind_the_last_sample_is_no_loss() -> None:
    found = find_pace(np.append(measured(), 8e5), NOMINAL_HZ)
    assert (found.stray, found.cuts) == ((COUNT,), ())


@given(
    st.lists(st.floats(-1e9, 1e9) | st.just(float("nan")), min_size=2, max_size=200).filter(
        lambda stamps: np.isfinite(stamps).sum() >= 2
    ),
    st.floats(1e-3, 1e5),
)
def test_any_stamps_can_be_judged(stamps: list[float], nominal_hz: float) -> None:
    found = find_pace(np.array(stamps), nominal_hz)
    assert found.period_s > 0
    assert all(0 < each < len(stamps) for each in found.cuts)


@pytest.mark.parametrize("name", ["three bursts", "many holes", "one sample"])
def test_cuts_do_not_depend_on_blocks_nor_on_sections(name: str) -> None:
    stamps, places, lost = LOSSES[name]
    stamps = without(stamps, places, lost)
    for blocks in (1, 7, 1000):
        cuts = Cuts(NOMINAL_HZ, section=4096)
        for block in np.array_split(stamps, blocks):
            cuts.take(block)
        cuts.end()
        assert tuple(cuts.numbers) == find_pace(stamps, NOMINAL_HZ).cuts
        assert [each.at for each in cuts.holes] == cuts.numbers


def _file(stamps: Array) -> bytes:
    values = np.arange(len(stamps), dtype=np.float32)[:, np.newaxis].tolist()
    return made.xdf(
        made.stream_header(1, "a", kind="ECG", rate=NOMINAL_HZ),
        made.samples(1, "float32", values, stamps.tolist()),
        made.clock_offset(1, float(stamps[0]), 0.0),
        made.footer(1, len(stamps)),
    )


def test_it_is_told_as_what_it_is() -> None:
    report = check(_file(bursts(delays(200))))
    assert codes(report, Level.ERROR) == codes(report, Level.WARNING) == set()
    text = text_of(report, "bursts", "a")
    assert text == "stamped in bursts of 73 each 0.56 s; 129.8 Hz; nothing seems lost"
    report = check(_file(overlaps(delays(200))))
    assert codes(report, Level.ERROR) == set()
    assert "its stamps overlap by up to" in text_of(report, "overlaps", "a")
    report = check(_file(without(bursts(delays(200)), [50 * BURST], 3 * BURST)))
    assert "1 gap of" in text_of(report, "gaps", "a")
    assert "about 21" in text_of(report, "gaps", "a")
    assert text_of(report, "bursts", "a").endswith("; samples are lost beside that")
