"""What is said of files in which one thing is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.xdf.findings import Level
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes, only, text_of
from tests.xdf.own_streams import own_header

RATE = 100.0


def _times(count: int, *, start: float = 1000.0, rate: float = RATE) -> list[float]:
    return [start + k / rate for k in range(count)]


def _one(stamps: list[float], *, rate: float = RATE, **header: Any) -> bytes:
    return x.xdf(*x.regular(1, "a", stamps, rate, **header))


def _drops() -> ET.Element:
    desc = ET.Element("desc")
    ET.SubElement(ET.SubElement(desc, "synchronization"), "can_drop_samples").text = "true"
    return desc


def test_nothing_is_found_in_a_good_file() -> None:
    report = check(_one(_times(3000)))
    assert not report.findings
    assert report.is_good
    figures = only(report).figures
    assert figures.rate_hz == pytest.approx(RATE)
    assert report.extent.length_s == pytest.approx(29.99)


def test_gaps_are_placed_from_the_begin_of_the_recording() -> None:
    stamps = _times(3000)
    late = _times(2000, start=1005.0)
    report = check(
        x.xdf(
            *x.regular(
                1, "a", stamps[:500] + stamps[700:1000] + stamps[1001:], RATE, desc=_drops()
            ),
            *x.regular(2, "b", late[:100] + late[600:], RATE, desc=_drops()),
        )
    )
    first, second = (each.figures.gaps for each in report.streams)
    assert (first.count, first.lost) == (2, 201)
    at = [report.extent.since_begin(gap.after, report.streams[0]) for gap in first.listed]
    assert at == pytest.approx([4.99, 9.99])
    assert [gap.length_s for gap in first.listed] == pytest.approx([2.01, 0.02])
    assert [gap.lost for gap in first.listed] == [200, 1]
    (gap,) = second.listed
    assert report.extent.since_begin(gap.after, report.streams[1]) == pytest.approx(5.99)
    assert codes(report) == {("gaps", "a"), ("gaps", "b")}
    # Between the gaps it runs as it should.
    assert report.streams[0].figures.rate_between_gaps_hz == pytest.approx(RATE)
    assert report.streams[0].figures.rate_hz == pytest.approx(2799 / 30, rel=0.01)


def test_the_clock_of_another_computer_does_not_shift_a_gap() -> None:
    stamps = _times(2000, start=77.0)
    header, samples, _ = x.regular(2, "b", stamps[:300] + stamps[400:], RATE, host="other")
    end = x.offsets(2, (77.0, 97.0), 923.0) + x.footer(2, 1900)
    report = check(x.xdf(*x.regular(1, "a", _times(2000), RATE), header, samples, end))
    (gap,) = report.streams[1].figures.gaps.listed
    assert report.extent.since_begin(gap.after, report.streams[1]) == pytest.approx(2.99)
    assert report.is_good


def test_stamps_of_another_program_may_jitter_but_gaps_shift_them_on_loading() -> None:
    jitter = np.random.default_rng(3).uniform(0, 0.05, 2000)
    stamps = sorted((np.array(_times(2000)) + jitter).tolist())
    assert not check(_one(stamps)).findings
    report = check(_one(stamps[:500] + stamps[600:]))
    assert codes(report) == {("gaps", "a"), ("smeared-gaps", "a")}
    assert ("gaps", "a") in codes(check(_one(stamps, desc=_drops()))), "its stamps are exact"


def test_a_gap_that_loaders_see_is_not_smeared() -> None:
    stamps = _times(3000)
    assert codes(check(_one(stamps[:500] + stamps[1200:]))) == {("gaps", "a")}


def test_irregular_streams_have_no_gaps() -> None:
    report = check(_one([1000.0, 1000.1, 1060.0, 1300.0], rate=0.0))
    assert not report.findings
    assert only(report).figures.gaps.count == 0


@pytest.mark.parametrize(
    ("actual", "level"), [(100.5, None), (95.0, Level.WARNING), (80.0, Level.ERROR)]
)
def test_rate(actual: float, level: Level | None) -> None:
    report = check(_one(_times(3000, rate=actual)))
    assert [f.level for f in report.findings if f.code == "rate"] == ([level] if level else [])


def test_stamps_that_run_backwards_or_are_no_numbers() -> None:
    stamps = _times(3000)
    stamps[700], stamps[1000], stamps[2000] = stamps[600], float("nan"), stamps[100]
    report = check(_one(stamps))
    expected = {"backwards", "bad-stamps", "stray-stamps"}
    assert codes(report, Level.ERROR) == {(code, "a") for code in expected}
    assert "in 1 place" in text_of(report, "backwards", "a")
    assert "1 stamp is" in text_of(report, "stray-stamps", "a")
    # No sample is missing.
    assert not only(report).figures.gaps.count
    report = check(_one(stamps, desc=_drops()))
    assert "in 2 places" in text_of(report, "backwards", "a")


@pytest.mark.parametrize("with_offsets", [True, False])
@pytest.mark.parametrize(
    ("start", "said"),
    [(1.78e9, "they are unix time"), (40e6, "away from"), (12.0, "s older|away from")],
)
def test_stamps_of_a_wrong_clock(start: float, said: str, with_offsets: bool) -> None:
    good = x.regular(1, "good", _times(3000), RATE, created_at=900.0)
    header, samples, _ = x.regular(
        2, "bad", _times(3000, start=start), RATE, created_at=900.0, desc=_drops()
    )
    offsets = x.offsets(2, (1005, 1010, 1015)) if with_offsets else b""
    report = check(x.xdf(*good, header, samples, offsets, x.footer(2, 3000)))
    assert ("wrong-clock", "bad") in codes(report, Level.ERROR)
    text = text_of(report, "wrong-clock", "bad")
    assert any(part in text for part in said.split("|"))
    # The stream does not make the recording 50 years long.
    assert report.extent.length_s == pytest.approx(29.99)


def test_a_footer_that_counts_otherwise() -> None:
    header, samples, _ = x.regular(1, "a", _times(3000), RATE)
    ends = {count: x.offsets(1, (1005, 1010)) + x.footer(1, count) for count in (2999, 2998, None)}
    found = {
        count: [(f.level, f.code) for f in check(x.xdf(header, samples, end)).findings]
        for count, end in ends.items()
    }
    assert found == {
        2999: [(Level.NOTE, "footer-count")],
        2998: [(Level.ERROR, "footer-count")],
        None: [(Level.WARNING, "footer-count")],
    }


def test_a_missing_footer() -> None:
    whole = x.regular(1, "a", _times(3000), RATE)
    header, samples, _ = x.regular(2, "b", _times(3000), RATE)
    offsets = x.offsets(2, (1005, 1010))
    one = check(x.xdf(*whole, header, samples, offsets))
    assert codes(one) == {("no-footer", "b")}
    assert not one.is_good
    none = check(x.xdf(header, samples, offsets))
    assert codes(none) == {("not-closed", "")}, "it is said once for the file"


def test_empty_streams() -> None:
    full = x.regular(1, "a", _times(3000), RATE)
    empty = [
        x.stream_header(2, "regular", rate=4.0)
        + x.stream_header(3, "irregular")
        + x.stream_header(4, "markers", kind="Markers", fmt="string")
        + x.stream_header(5, "int64", fmt="int64", rate=1.0)
    ]
    ends = [x.offsets(k, (1005, 1010)) + x.footer(k, 0) for k in (2, 3, 4)]
    report = check(x.xdf(*full, *empty, *ends))
    assert codes(report, Level.ERROR) == {("no-samples", "regular"), ("int64", "int64")}
    assert codes(report, Level.NOTE) == {("no-samples", "irregular"), ("no-samples", "markers")}


@pytest.mark.parametrize(
    ("length_s", "level"), [(0.5, Level.WARNING), (2.9, Level.WARNING), (3.1, Level.ERROR)]
)
def test_a_slow_stream_may_have_no_sample_in_a_short_recording(
    length_s: float, level: Level
) -> None:
    slow = x.stream_header(2, "slow", rate=1.0) + x.footer(2, 0)
    report = check(x.xdf(*x.regular(1, "a", _times(round(length_s * RATE)), RATE), slow))
    assert ("no-samples", "slow") in codes(report, level)


def test_a_file_without_streams_or_samples() -> None:
    assert codes(check(x.xdf())) == {("no-streams", "")}
    only_header = check(x.xdf(x.stream_header(1, "a"), x.footer(1, 0)))
    assert ("no-samples", "") in codes(only_header, Level.ERROR)


def test_duplicates() -> None:
    streams = [
        x.regular(1, "a", _times(3000), RATE, source_id="one"),
        x.regular(2, "a", _times(3000), RATE, source_id="two"),
        x.regular(3, "b", _times(3000), RATE, source_id="two"),
        x.regular(4, "c", _times(3000), RATE, source_id=""),
        x.regular(5, "d", _times(3000), RATE, source_id=""),
    ]
    report = check(x.xdf(*(part for stream in streams for part in stream)))
    assert text_of(report, "duplicate-source-id") == "2 streams have the source_id 'two'"
    assert text_of(report, "duplicate-name") == "2 streams have the name 'a'"
    assert codes(report, Level.WARNING) == {
        ("duplicate-name", ""),
        ("no-source-id", "c"),
        ("no-source-id", "d"),
    }


def _with_offsets(
    offsets: Sequence[tuple[float, float]], seconds: float = 30.0, **header: Any
) -> bytes:
    stamps = _times(int(seconds * RATE))
    head, samples, _ = x.regular(1, "a", stamps, RATE, **header)
    measured = b"".join(x.clock_offset(1, time, offset) for time, offset in offsets)
    return x.xdf(head, samples, measured, x.footer(1, len(stamps)))


def test_clock_offsets() -> None:
    times = np.arange(1005.0, 1030.0, 5.0)
    drifting = [(float(t), 0.2 + (t - 1000) * 40e-6) for t in times]
    figures = only(check(_with_offsets(drifting))).figures.offsets
    assert figures.count == 5
    assert figures.drift_ppm == pytest.approx(40)
    assert figures.lowest_s == pytest.approx(0.2002)
    assert figures.highest_s == pytest.approx(0.201)
    assert not check(_with_offsets(drifting)).findings
    fast = [(float(t), (t - 1000) * 900e-6) for t in times]
    assert codes(check(_with_offsets(fast))) == {("drift", "a")}
    rough = [(float(t), 0.1 * (k % 2)) for k, t in enumerate(times)]
    assert ("offset-scatter", "a") in codes(check(_with_offsets(rough)))


def test_missing_clock_offsets() -> None:
    assert codes(check(_with_offsets([])), Level.WARNING) == {("no-offsets", "a")}
    short = check(_with_offsets([], seconds=4.5))
    assert codes(short, Level.NOTE) == {("no-offsets", "a")}
    assert short.is_good


def test_streams_of_two_computers_cannot_be_aligned_without_offsets() -> None:
    header, samples, _ = x.regular(2, "b", _times(3000), RATE, host="other")
    report = check(
        x.xdf(*x.regular(1, "a", _times(3000), RATE), header, samples, x.footer(2, 3000))
    )
    assert codes(report, Level.ERROR) == {("not-aligned", "")}


def test_what_a_device_computes_for_seconds_lets_nothing_begin_late() -> None:
    wristband = DeviceIdentity("empatica_e4", "A1", "P01")
    stamps = _times(200, start=1006.0, rate=64)
    report = check(
        x.xdf(
            own_header(1, wristband, "hr"),
            x.samples(1, "float32", [[72.0]] * 2, [1000.0, 1008.0]),
            x.offsets(1, (1005, 1010, 1015)) + x.footer(1, 2),
            own_header(2, wristband, "bvp"),
            x.samples(2, "float32", [[1.0]] * len(stamps), stamps),
            x.offsets(2, (1005, 1010, 1015)) + x.footer(2, len(stamps)),
        )
    )
    assert "begins-late" not in {code for code, _ in codes(report)}
    assert report.extent.begin == stamps[0]


def test_a_stream_that_begins_late_or_ends_early() -> None:
    report = check(
        x.xdf(
            *x.regular(1, "a", _times(3000), RATE),
            *x.regular(2, "late", _times(2000, start=1010.0), RATE),
            *x.regular(3, "short", _times(2000), RATE),
        )
    )
    assert codes(report) == {("begins-late", "late"), ("ends-early", "short")}
    assert "10.0 s" in text_of(report, "begins-late", "late")


def test_channels_without_values() -> None:
    stamps = _times(3000)
    rows = [[float("nan"), float("nan") if k % 4 == 0 else 1.0, 1.0] for k in range(3000)]
    report = check(
        x.xdf(
            x.stream_header(1, "a", rate=RATE, channels=3),
            x.samples(1, "float32", rows, stamps),
            x.offsets(1, (1005, 1010)),
            x.footer(1, 3000),
        )
    )
    assert codes(report) == {("no-values", "a"), ("nan", "a")}
    assert text_of(report, "nan", "a").endswith("2 25%")
    assert only(report).figures.nan_shares == (1.0, 0.25, 0.0)
