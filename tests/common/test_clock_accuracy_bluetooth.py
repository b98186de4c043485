"""A device clock on fifteen minutes of real Bluetooth LE: a Muse S Athena, one minute at a time.

``recorded_arrivals/README.md`` says where they come from. True times are not known: the stamps
are compared with the lower edge of the whole minute, which is found in hindsight.
"""

from __future__ import annotations

import csv
import gzip
from itertools import groupby
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest

from biosensor_common.device_clock import DeviceClock
from tests.rigs.hindsight import Floats, line_in_hindsight

RECORDED = Path(__file__).with_name("recorded_arrivals") / "muse_s_athena_2025-09-25.csv.gz"
TICKS_PER_S = 256_000
SETTLED_S = 10.0


@pytest.fixture(scope="module")
def minutes() -> dict[str, Floats]:
    """Return device time and arrival of each packet by recording, shape (2, n), seconds."""
    with gzip.open(RECORDED, "rt", encoding="ascii") as lines:
        rows = list(csv.DictReader(lines))
    return {
        name: np.array(
            [
                (int(row["device_ticks"]) / TICKS_PER_S, int(row["arrival_us"]) / 1e6)
                for row in packets
            ]
        ).T
        for name, packets in groupby(rows, itemgetter("recording"))
    }


def _errors_ms(device_s: Floats, arrival_s: Floats) -> Floats:
    """Stamp each packet as it comes; return by how much the settled stamps miss the edge."""
    clock = DeviceClock()
    stamps_s: list[float] = []
    for device, arrival in zip(device_s.tolist(), arrival_s.tolist(), strict=True):
        assert clock.observe(device, arrival) is None
        stamps_s.append(clock.to_lsl(device))
    errors: Floats = 1e3 * (np.array(stamps_s) - line_in_hindsight(device_s, arrival_s))
    return errors[arrival_s > arrival_s[0] + SETTLED_S]


def test_it_is_a_radio_that_delays(minutes: dict[str, Floats]) -> None:
    delays_ms = [
        1e3 * (arrival_s - line_in_hindsight(device_s, arrival_s))
        for device_s, arrival_s in minutes.values()
    ]

    assert len(delays_ms) == 15
    assert all(29.0 < delays.std() < 50.0 for delays in delays_ms)
    assert all(160.0 < delays.max() < 201.0 for delays in delays_ms)


def test_stamps_keep_to_the_edge_of_the_whole_minute(minutes: dict[str, Floats]) -> None:
    errors_ms = [_errors_ms(*each) for each in minutes.values()]
    rms_ms = [errors.std() for errors in errors_ms]
    whole_ms = [np.sqrt((errors**2).mean()) for errors in errors_ms]

    print(
        f"\nRMS {np.median(rms_ms):.2f} ms in the median, {max(rms_ms):.2f} in the worst;"
        f" nothing removed {np.median(whole_ms):.2f} and {max(whole_ms):.2f},"
        f" at most {max(np.abs(errors).max() for errors in errors_ms):.2f}"
    )
    assert np.median(rms_ms) < 0.6
    assert max(rms_ms) < 1.0
    assert max(whole_ms) < 2.0


def test_and_so_do_they_if_the_minute_is_turned_round(minutes: dict[str, Floats]) -> None:
    rms_ms: list[float] = []
    for device_s, arrival_s in minutes.values():
        # The same delays in another order: what was chosen by one need not suit the other.
        device, arrival = -device_s[::-1], -line_in_hindsight(device_s, arrival_s)[::-1]
        arrival += (arrival_s - line_in_hindsight(device_s, arrival_s))[::-1]
        order = np.argsort(arrival, kind="stable")
        rms_ms.append(_errors_ms(device[order], arrival[order]).std())

    print(f"\nRMS {np.median(rms_ms):.2f} ms in the median, {max(rms_ms):.2f} in the worst")
    assert np.median(rms_ms) < 0.5
    assert max(rms_ms) < 1.5
