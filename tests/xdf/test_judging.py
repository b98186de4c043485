"""What is said of files in which one thing is wrong, missing or known beforehand."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from biosensor_common.lsl_header import describe
from biosensor_common.naming import NODE, lsl_name, source_id
from biosensor_common.quantities import ChannelFormat
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_common.stream_header import CoreFields, foreign_header
from biosensor_gateway.demo.virtual_devices import simulated_settings
from biosensor_gateway.devices.registry import declaration, sensor, sensor_names
from biosensor_gateway.features.outputs import features_of
from biosensor_gateway.features.sources import judge as judge_source
from biosensor_gateway.features.sources import stream_info
from biosensor_gateway.recording.recorder.live_file import Growth
from biosensor_gateway.recording.xdf.counters import Reading, newest_of_each_kind, refusals
from biosensor_gateway.recording.xdf.findings import (
    Finding,
    Level,
    VisibleStream,
    by_event,
    late_streams,
)
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.report_text import as_json, as_text
from biosensor_gateway.recording.xdf.verdict import Colour, by_devices, by_name, judge, verdict
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.outlets import Outlet
from lsl_to_ros.reports.clock_pairs import EVENTS
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes, only, text_of
from tests.xdf.own_streams import own_header
from tests.xdf.test_participants import AGENT, heartbeat, judged, recorded, strap

# What is said of files in which one thing is wrong.

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


@pytest.mark.parametrize(
    ("relative", "level"), [(1.02, Level.NOTE), (1.05, Level.WARNING), (1.2, Level.ERROR)]
)
def test_a_chip_of_a_device_of_ours_counts_by_an_oscillator_of_its_own(
    relative: float, level: Level
) -> None:
    rate = declaration("empatica_e4").stream("acc").rate
    assert isinstance(rate, float | int)
    stamps = _times(3000, rate=rate * relative)
    content = x.xdf(
        own_header(1, DeviceIdentity("empatica_e4", "lab"), "acc"),
        x.samples(1, "float32", [[0.0, 0.0, 1.0]] * 3000, stamps),
        x.offsets(1, (1005, 1010)) + x.footer(1, 3000),
    )
    assert [each.level for each in check(content).findings if each.code == "rate"] == [level]


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


@pytest.mark.parametrize("jitter_s", [0.0, 0.002])
def test_how_many_samples_may_be_there_twice(jitter_s: float) -> None:
    stamps = np.array(_times(3000))
    doubled = np.concatenate([stamps[:1000], stamps[960:1000], stamps[1000:]])
    doubled += np.random.default_rng(1).uniform(0.0, jitter_s, len(doubled))
    about = "about " if jitter_s else ""
    told = text_of(check(_one(doubled.tolist())), "backwards", "a")
    assert told.endswith(f": {about}40 samples are duplicated, or its sender's clock was set back")
    # More than all there are cannot be there twice.
    restarted = np.concatenate([stamps[:1000], stamps[1000:] - stamps[1000] + 1.0])
    told = text_of(check(_one(restarted.tolist())), "backwards", "a")
    assert told.endswith(" s: its sender's clock was set back")


def test_markers_in_another_order_than_their_times_are_no_error() -> None:
    header = x.stream_header(1, "told", kind="Markers", fmt="string")
    samples = x.samples(1, "string", [["c"], ["a"], ["b"]], [13.0, 11.0, 12.0])
    report = check(x.xdf(header, samples, x.offsets(1, (10.0, 20.0)), x.footer(1, 3)))
    assert ("backwards", "told") in codes(report, Level.WARNING)
    assert report.is_good


def test_a_stream_that_names_no_computer_is_of_no_other_one() -> None:
    known = x.regular(1, "a", _times(3000), 100.0)
    unknown = x.stream_header(2, "b", host="", kind="Markers", fmt="string")
    marker = x.samples(2, "string", [["x"]], [_times(2)[1]])
    report = check(x.xdf(*known, unknown, marker, x.footer(2, 1)))
    assert "not-aligned" not in {each.code for each in report.findings}
    assert "on a computer without a name" in as_text(report)


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
    # Infinite values are none either.
    none = [float("nan"), float("inf"), float("-inf")]
    rows = [[none[k % 3], none[k // 4 % 3] if k % 4 == 0 else 1.0, 1.0] for k in range(3000)]
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


@pytest.mark.parametrize(
    ("kind", "length_s", "level"),
    [
        ("RespirationRate", 30, Level.NOTE),
        ("RespirationRate", 60, Level.WARNING),
        ("Quality", 30, Level.NOTE),
        ("Quality", 60, Level.WARNING),
        ("HeartRate", 30, Level.WARNING),
    ],
)
def test_what_needs_several_breaths_or_beats_takes_time(
    kind: str, length_s: int, level: Level
) -> None:
    count = int(length_s * RATE)
    report = check(
        x.xdf(
            x.stream_header(1, "a", kind=kind, rate=RATE),
            x.samples(1, "float32", [[float("nan")]] * count, _times(count)),
            x.offsets(1, (1005, 1010)),
            x.footer(1, count),
        )
    )
    assert [each.level for each in report.findings if each.code == "no-values"] == [level]


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ("a", ""),  # It came before the recorder searched.
        ("ab", "b (lab) appeared after the recording began, and is not in it: start its program"),
        ("bc", "b (lab), c (lab) appeared after the recording began, and are not in it: start"),
        ("bcdefgh", "f (lab) and 2 more appeared after the recording began, and are not in it"),
    ],
)
def test_streams_that_appear_after_the_begin_are_named(names: str, told: str) -> None:
    late = [VisibleStream(each, f"{each}-id", "lab") for each in names]
    found = list(late_streams(late, {("a", "a-id")}))
    assert [told in each.text for each in found] == ([True] if told else [])
    assert all(each.level is Level.WARNING for each in found)


# A sensor that was paused or not connected is named in the verdict.
STREAMING = {"polar_h10__A1": "streaming"}


def event(kind: str, at: float) -> dict[str, object]:
    return {"event": kind, "sensor": "polar_h10", "unit": "A1", "participant": "P01",
            "lsl_time": at}  # fmt: skip


@pytest.mark.parametrize("how", [("paused", "paused"), ("discovering", "not connected")])
def test_who_was_away_the_whole_time_is_named(how: tuple[str, str]) -> None:
    state, word = how
    report = judged("P01", strap("P01"), events=[heartbeat(polar_h10__A1=state)])
    assert codes(report, Level.WARNING) == {("away", "")}
    assert text_of(report, "away") == f"polar_h10/A1 of P01 was {word} the whole time"


@pytest.mark.parametrize(
    ("kinds", "said"),
    [
        (("paused", "resumed"), "paused from 5.0 s to 8.0 s"),
        (("paused", "disconnected"), "paused from 5.0 s to the end"),
        (("disconnected", "connected"), "not connected from 5.0 s to 8.0 s"),
    ],
)
def test_from_when_to_when(kinds: tuple[str, str], said: str) -> None:
    changes = [event(kinds[0], 1005.0), event(kinds[1], 1008.0)]
    events: list[object] = [heartbeat(**STREAMING), *changes]
    report = judged("P01", strap("P01"), events=events)
    assert text_of(report, "away") == f"polar_h10/A1 of P01 was {said}"


@pytest.mark.parametrize(("started", "is_other"), [(1007.5, False), (950.0, True)])
def test_another_agent_is_told_from_one_that_was_started_again(
    started: float, is_other: bool
) -> None:
    """As LabRecorder did when an agent was killed and one of another session had its names."""
    first = heartbeat(**STREAMING) | {"agent_started": 900.0, "lsl_time": 1006.0}
    second = first | {"agent_started": started, "lsl_time": 1009.0}
    report = judged("P01", strap("P01"), events=[first, first, second, second])
    found = [each for each in report.findings if each.code == "another-agent"]
    assert [each.level for each in found] == [Level.ERROR] * is_other
    if is_other:
        assert found[0].text.startswith("from 9.0 s on it belongs to another agent")
        assert verdict(report).colour is Colour.RED


@pytest.mark.parametrize(("started", "is_other"), [(1007.5, False), (950.0, True)])
def test_sensors_that_another_agent_does_not_have_were_not_removed(
    started: float, is_other: bool
) -> None:
    first = heartbeat(**STREAMING) | {"agent_started": 900.0, "lsl_time": 1006.0}
    second = heartbeat(zephyr__B="streaming") | {"agent_started": started, "lsl_time": 1009.0}
    report = judged("P01", strap("P01"), events=[first, first, second, second])
    told = {code for code, _ in codes(report, Level.ERROR)}
    assert told & {"another-agent", "removed"} == {"another-agent" if is_other else "removed"}


def test_a_step_of_the_time_of_day_between_two_heartbeats_is_amber() -> None:
    def beat(at: float, by_s: float) -> dict[str, object]:
        clock = {"lsl_s": at, "unix_ns": round((1.8e9 + at + by_s) * 1e9)}
        return heartbeat(**STREAMING) | {"agent_started": 900.0, "lsl_time": at, "clock": clock}

    told = ((1001.0, 0.0), (1006.0, -90.0), (1011.0, -90.0), (1016.0, -65.0))
    events: list[object] = [beat(*each) for each in told]
    report = judged("P01", strap("P01"), events=events)
    texts = [each.text for each in report.findings if each.code == "clock-set"]
    assert len(texts) == 2
    assert ": between 1.0 s and 6.0 s its clock was set back by 90.0 s" in texts[0]
    assert "between 11.0 s and 16.0 s it slept for 25.0 s, or" in texts[1]
    assert verdict(report).colour is Colour.AMBER


def told_recording(events: Sequence[object], *stamps: float) -> bytes:
    """Return a recording of a strap's acceleration, and what its agent tells."""
    texts = [[json.dumps(each)] for each in events]
    return x.xdf(
        own_header(1, strap("P01"), "acc"),
        x.samples(1, "float32", [[0.0, 0.0, k % 7.0] for k in range(len(stamps))], [*stamps]),
        x.offsets(1, (1005, 1010, 1015)),
        x.footer(1, len(stamps)),
        own_header(9, AGENT, "events"),
        x.samples(9, "string", texts, [1001.0 + k for k in range(len(texts))]),
        x.offsets(9, (1005, 1010, 1015)),
        x.footer(9, len(texts)),
    )


def paused_recording(*stamps: float, more: Sequence[object] = ()) -> bytes:
    """Return a recording of a strap's acceleration, which was paused from 5 to 8 s."""
    changes = [event("paused", 1005.0), event("resumed", 1008.0)]
    return told_recording([heartbeat(**STREAMING), *changes, *more], *stamps)


def acc(begin: float, end: float) -> list[float]:
    return (begin + np.arange(round((end - begin) * 50)) / 50).tolist()


def test_a_gap_in_a_pause_is_no_loss() -> None:
    report = check(paused_recording(*acc(1000, 1005), *acc(1009, 1020)))
    name = "P01-polar_h10-A1-acc"
    assert ("gaps", name) not in codes(report)
    assert text_of(report, "paused", name) == "1 pause of 4.02 s in total; nothing is lost"
    assert "lost)" not in as_text(report)
    (judged_stream,) = (each for each in verdict(report).streams if each.name == name)
    assert judged_stream.gaps == 0


def test_a_gap_beside_a_pause_is_a_loss_all_the_same() -> None:
    report = check(paused_recording(*acc(1000, 1002), *acc(1002.5, 1005), *acc(1009, 1020)))
    text = text_of(report, "gaps", "P01-polar_h10-A1-acc")
    assert text.startswith("1 gap of 0.52 s in total, about 25 samples lost")
    # Longer than the pause by more than its edges.
    report = check(paused_recording(*acc(1000, 1002), *acc(1012, 1020)))
    assert ("gaps", "P01-polar_h10-A1-acc") in codes(report)


DROP = [
    heartbeat(**STREAMING),
    event("disconnected", 1005.0),
    event("connected", 1008.0),
]


def test_a_gap_while_a_device_was_away_is_one_event_with_it() -> None:
    report = check(told_recording(DROP, *acc(1000, 1005), *acc(1009, 1020)))
    (event_found,) = by_event([e for e in report.findings if e.level is Level.WARNING])
    head, consequences = event_found
    assert head.text == "polar_h10/A1 of P01 was not connected from 5.0 s to 8.0 s"
    # Nothing of it is kept from a script.
    assert [(each.code, each.part_of) for each in consequences] == [("gaps", head.text)]
    assert verdict(report).sentence.endswith(
        "the file is intact, but 1 thing happened that the analysis must consider"
    )
    told = as_text(report)
    assert f"warning: {head.text}; because of that:\n    P01-polar_h10-A1-acc: 1 gap of" in told
    assert "1 warning" in told


@pytest.mark.parametrize(
    "stamps",
    [
        (*acc(1000, 1002), *acc(1002.5, 1005), *acc(1009, 1020)),
        (*acc(1000, 1002), *acc(1012, 1020)),
    ],
)
def test_a_gap_that_an_absence_does_not_explain_is_another_event(stamps: Sequence[float]) -> None:
    report = check(told_recording(DROP, *stamps))
    found = by_event([each for each in report.findings if each.level is Level.WARNING])
    assert [(head.code, parts) for head, parts in found] == [("away", []), ("gaps", [])]


def test_who_is_away_to_the_end_and_ends_early_is_one_event() -> None:
    events = [heartbeat(**STREAMING), event("disconnected", 1005.0)]
    other = told_recording(events, *acc(1000, 1005))
    tail = x.xdf(
        own_header(4, strap("P02"), "acc"),
        x.samples(4, "float32", [[0.0, 0.0, k % 7.0] for k in range(1000)], acc(1000, 1020)),
        x.offsets(4, (1005, 1010, 1015)),
        x.footer(4, 1000),
    )
    report = check(other + tail[len(x.xdf()) :])
    found = by_event([each for each in report.findings if each.code in ("away", "ends-early")])
    ((head, parts),) = found
    assert (head.code, [each.code for each in parts]) == ("away", ["ends-early"])


def test_a_restart_of_the_agent_is_one_event_with_its_gaps() -> None:
    first = heartbeat(**STREAMING) | {"agent_started": 900.0, "lsl_time": 1004.0}
    second = heartbeat(**STREAMING) | {"agent_started": 1006.5, "lsl_time": 1008.0}
    report = check(told_recording([first, second], *acc(1000, 1005), *acc(1009, 1020)))
    ((head, parts),) = by_event([e for e in report.findings if e.level is Level.WARNING])
    assert head.text == "the agent was restarted between 4.0 s and 8.0 s"
    assert [each.code for each in parts] == ["gaps"]


def test_one_kind_of_refusal_is_told_once_with_its_newest_count() -> None:
    one = "1 sample was left out: hr was 300"
    more = "2 samples were left out: hr was 301.5"
    assert newest_of_each_kind([one, more]) == [more]
    others = ["ch1 has not changed for 10 s", "ch2 has not changed for 10 s"]
    assert newest_of_each_kind(others) == others


def test_of_one_that_comes_and_goes_the_rest_is_counted() -> None:
    events: list[object] = [heartbeat(**STREAMING)]
    for k in range(5):
        events += [event("disconnected", 1002.0 + 4 * k), event("connected", 1003.0 + 4 * k)]
    text = text_of(judged("P01", strap("P01"), events=events), "away")
    assert text.count("not connected") == 3
    assert text.endswith(" and 2 more times")


def test_nothing_is_said_of_one_that_streamed() -> None:
    events: list[object] = [heartbeat(**STREAMING), event("connected", 1003.0)]
    assert judged("P01", strap("P01"), events=events).is_good
    assert not codes(judged("P01", strap("P01"), events=events), Level.WARNING)


def test_one_of_which_nothing_came_is_red(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.xdf.test_participants.STAMPS", [])
    other = DeviceIdentity("zephyr", "B", "P01")
    report = judged("P01", strap("P01"), other, events=[heartbeat(polar_h10__A1="paused")])
    assert codes(report, Level.ERROR) == {("away", "")}
    assert text_of(report, "away").endswith("the whole time, and none of its data was recorded")


WHOLE_EVENTS: list[dict[str, Any]] = [
    heartbeat(**STREAMING) | {"agent_started": 900.0, "clock": {"lsl_s": 1001.0, "unix_ns": 10**18},
                              "problems": {"polar_h10/A1": [{"what": "x", "last": 1009.0}]}},
    event(EventKind.STREAMS_SILENT, 1008.0) | {"seconds": 5.2, "streams": ["acc"]},
    event(EventKind.CLOCK_REANCHORED, 1009.0) | {"seconds": 5.2},
    event("paused", 1005.0), event("resumed", 1008.0), event("device_removed", 1012.0),
]  # fmt: skip
# JSON has integers that no float holds, and Python's also reads NaN.
ODD = [10**400, -(10**400), 1e308, 10**18, float("nan"), None, True, "text", [], {}, [1], {"a": 1}]


def _places(content: object, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the way to each value of JSON."""
    parts: Iterable[tuple[Any, Any]] = ()
    if isinstance(content, dict):
        parts = cast("dict[str, Any]", content).items()
    elif isinstance(content, list):
        parts = enumerate(cast("list[Any]", content))
    for key, part in parts:
        yield (*place, key)
        yield from _places(part, (*place, key))


@pytest.mark.parametrize("number", range(len(WHOLE_EVENTS)))
def test_an_event_that_was_damaged_or_made_up_stops_nobody(number: int, tmp_path: Path) -> None:
    file = tmp_path / "sub-P01.xdf"
    for *inside, last in _places(WHOLE_EVENTS[number]):
        for odd in ODD:
            events: list[Any] = json.loads(json.dumps(WHOLE_EVENTS))
            content = events[number]
            for key in inside:
                content = content[key]
            content[last] = odd
            file.write_bytes(recorded(strap("P01"), events=events))
            report = judge(read_recording(file))
            assert as_text(report)
            assert as_json(report)
            growth = Growth(file)
            assert growth.look().streams
            list(growth.story("", 950.0))


# What the agent said of late, refused and jumping data stands in the verdict.
LATE = "2 samples had waited with others"


def test_a_silence_is_told_with_its_longest() -> None:
    silent = event(EventKind.STREAMS_SILENT, 1008.0)
    events: list[object] = [
        heartbeat(**STREAMING),
        silent | {"seconds": 5.2, "streams": ["acc", "ecg"]},
        silent | {"seconds": 9.8, "streams": ["ecg"], "lsl_time": 1012.0},
    ]
    report = judged("P01", strap("P01"), events=events)
    assert codes(report, Level.WARNING) == {("silent", "")}
    text = text_of(report, "silent")
    assert text.startswith("polar_h10/A1 of P01 ")
    assert "2 times, for ecg 9.8 s until 12.0 s" in text


@pytest.mark.parametrize(("seconds", "is_told"), [(-6.87, True), (None, False)])
def test_a_jump_is_told_unless_nothing_was_stamped_before_it(
    seconds: float | None, is_told: bool
) -> None:
    jump = event(EventKind.CLOCK_REANCHORED, 1008.0)
    events: list[object] = [
        heartbeat(**STREAMING),
        jump | ({} if seconds is None else {"seconds": seconds}),
    ]
    report = judged("P01", strap("P01"), events=events)
    assert codes(report, Level.WARNING) == ({("clock-jumped", "")} if is_told else set())
    if is_told:
        text = text_of(report, "clock-jumped")
        assert "polar_h10/A1 of P01 jumped by -6.870 s at 8.0 s" in text


def test_nothing_is_said_of_a_sensor_that_is_not_in_the_file() -> None:
    other = event(EventKind.CLOCK_REANCHORED, 1008.0) | {"sensor": "zephyr", "seconds": 2.0}
    report = judged("P01", strap("P01"), events=[heartbeat(**STREAMING), other])
    assert not codes(report, Level.WARNING)


FULL = "connected, but the device refuses hr (/Meas/HR is refused (507): it has no room)"


@pytest.mark.parametrize(
    ("problems", "said"),
    [
        ({"what": FULL}, FULL),
        ({"what": "3 bytes could not be read", "last": 1009.0}, "3 bytes could not be read"),
        # It was before the recording, and is told for some seconds.
        ({"what": "3 bytes could not be read", "last": 990.0}, None),
        ("no problem", None),
    ],
)
def test_what_a_device_refuses_is_told_of_the_device(problems: object, said: str | None) -> None:
    told = heartbeat(**STREAMING) | {"problems": {"polar_h10/A1": [problems]}}
    later = told | {"lsl_time": 1010.0}
    report = judged("P01", strap("P01"), events=[told, later])
    assert codes(report, Level.WARNING) == ({("refused", "")} if said else set())
    if said:
        assert text_of(report, "refused") == f"polar_h10/A1 of P01: {said}"


def reading(at: float, *sentences: str) -> Reading:
    return Reading(0, 0, at, told_at=at, refused=sentences)


@pytest.mark.parametrize(
    ("readings", "told"),
    [
        ([reading(0.0), reading(1.0, LATE)], [LATE]),
        # Of one kind the newest.
        ([reading(0.0), reading(1.0, LATE), reading(2.0, "5" + LATE[1:])], ["5" + LATE[1:]]),
        # It was before, and is shown for ten seconds.
        ([reading(0.0, LATE), reading(9.0, LATE), reading(11.0)], []),
        # What stays is of now.
        ([reading(0.0, LATE), reading(11.0, LATE)], [LATE]),
    ],
)
def test_which_sentences_are_of_the_recording(readings: list[Reading], told: list[str]) -> None:
    assert refusals(readings) == told


# Which streams are expected, and what is said of those that are not there.
FILE = x.xdf(
    *x.regular(1, "a", [1000 + k / 10 for k in range(300)], 10.0),
    x.stream_header(2, "empty"),
    x.offsets(2, (1005, 1010)),
    x.footer(2, 0),
)


@pytest.mark.parametrize("name", ["a", "a-id"])
def test_a_stream_is_expected_by_name_or_source_id(name: str) -> None:
    assert check(FILE, *by_name([name])).is_good


def test_a_missing_stream_is_an_error() -> None:
    assert codes(check(FILE, *by_name(["a", "b"])), Level.ERROR) == {("missing", "b")}


def test_a_stream_that_is_asked_for_must_have_samples() -> None:
    assert check(FILE).is_good
    report = check(FILE, *by_name(["empty"]))
    assert codes(report, Level.ERROR) == {("expected-empty", "empty")}


def test_every_stream_of_every_enabled_device_is_expected() -> None:
    devices = [
        DeviceSettings(sensor="zephyr", unit="1", participant="p01", label="left"),
        DeviceSettings(sensor="polar_h10", unit="2", enabled=False),
    ]
    identity = DeviceIdentity("zephyr", "1", "p01", "left")
    names = {f"p01-zephyr__left-1-{each.data_name}" for each in declaration("zephyr").streams}
    expected = by_devices(devices)
    assert {each.name for each in expected} == names
    assert {each.source_id for each in expected} == {
        f"p01@zephyr.left-{each.data_name}" for each in declaration("zephyr").streams
    }
    report = check(FILE, *expected)
    assert codes(report, Level.ERROR) == {("missing", name) for name in names}
    # What is expected is what the agent really names its outlet.
    outlet = Outlet(declaration("zephyr").stream("ecg"), identity, DeviceInfo())
    assert (outlet.name, outlet.source_id) in {(each.name, each.source_id) for each in expected}


def test_a_stream_of_a_sensor_may_be_empty() -> None:
    (expected,) = (
        e
        for e in by_devices([DeviceSettings(sensor="zephyr", unit="1")])
        if e.source_id == "zephyr-1-st"
    )
    header = x.stream_header(2, "empty", source_id="zephyr-1-st")
    content = FILE.replace(x.stream_header(2, "empty"), header)
    assert content != FILE
    assert check(content, expected).is_good


def test_all_sensors_can_be_expected() -> None:
    with simulated_settings(["all"]) as settings:
        expected = {device.sensor: by_devices([device]) for device in settings.devices}
    assert set(expected) == {name for name in sensor_names() if sensor(name).virtual}
    assert all(expected.values())


# What tells of a device was measured before the recording, perhaps long before.
STRAP = DeviceIdentity("polar_h10", "A1B2")
BEGIN_S = 5000.0
ECG = CoreFields("ecg", "ECG", "id", "host", 1, 130.0, ChannelFormat.FLOAT32)


def _recording(told_s: float, name: str = "bat") -> bytes:
    heart = [BEGIN_S + k for k in range(20)]
    offsets = (BEGIN_S, BEGIN_S + 10, BEGIN_S + 20)
    return x.xdf(
        own_header(1, STRAP, "hr") + x.samples(1, "float32", [[60.0]] * 20, [*heart]),
        own_header(2, STRAP, name) + x.samples(2, "float32", [[90.0]], [told_s]),
        *(
            x.offsets(number, offsets) + x.footer(number, count)
            for number, count in ((1, 20), (2, 1))
        ),
    )


@pytest.mark.parametrize("name", ["bat", "quality"])
@pytest.mark.parametrize("before_s", [10.0, 100.0, 4000.0])
def test_what_a_device_told_before_is_no_error_and_no_begin(before_s: float, name: str) -> None:
    report = check(_recording(BEGIN_S - before_s, name))
    assert codes(report, Level.ERROR) == codes(report, Level.WARNING) == set()
    assert (report.extent.begin, report.extent.end) == (BEGIN_S, BEGIN_S + 19)


def test_one_of_after_it_is_on_another_clock() -> None:
    report = check(_recording(BEGIN_S + 100.0))
    assert {code for code, _ in codes(report, Level.ERROR)} == {"wrong-clock"}


def test_nothing_but_states_is_a_recording_too() -> None:
    content = own_header(1, STRAP, "bat") + x.samples(1, "float32", [[90.0]], [BEGIN_S])
    report = check(x.xdf(content, x.offsets(1, (BEGIN_S + 60, BEGIN_S + 70)), x.footer(1, 1)))
    assert (report.extent.begin, report.extent.end) == (BEGIN_S, BEGIN_S + 70)


@pytest.mark.parametrize(("length_s", "level"), [(20, Level.NOTE), (400, Level.WARNING)])
def test_a_feature_that_looks_back_further_than_the_recording_is_no_fault(
    length_s: int, level: Level
) -> None:
    """The header says how far back; what only qualifies a value may be told by nobody."""
    feature = next(each for each in features_of("ECG", "ecg", "mV") if each.name == "hrv_live")
    source = judge_source("ecg", "id", foreign_header(ECG, ("1",), ("mV",)))
    assert source is not None
    source = replace(source, identity=STRAP)
    root = ET.fromstring(stream_info(source, feature).as_xml())
    labels = [each.label for each in feature.stream.channels]
    stamps = [BEGIN_S + k for k in range(length_s)]
    row = [1.0 if "covered" in label else float("nan") for label in labels]
    header = x.chunk(2, b"\x01\0\0\0" + ET.tostring(root))
    content = x.xdf(
        header,
        x.samples(1, "float32", [row] * length_s, stamps),
        x.offsets(1, (BEGIN_S, BEGIN_S + 10, BEGIN_S + 20)) + x.footer(1, length_s),
    )
    found = [each for each in check(content).findings if each.code == "no-values"]
    assert {each.level for each in found if "RMSSD_300s" in each.text} == {level}
    assert {each.level for each in found if "motion_300s" in each.text} == {Level.NOTE}


# What is said of streams that ``ros_to_lsl`` made, by what it found out of the robot's clock.
STAMPS = [1000.0 + k / 50 for k in range(500)]
HOST = "lab"


def robot(clock: str, edge_s: float | None, stamped_by: str = "header") -> tuple[bytes, ...]:
    desc = ET.Element("desc")
    ET.SubElement(ET.SubElement(desc, "synchronization"), "can_drop_samples").text = "true"
    ros = ET.SubElement(desc, "ros")
    told = {"topic": "/pose", "stamp_source": stamped_by, "clock": clock}
    if edge_s is not None:
        told["clock_edge_s"] = f"{edge_s:.6f}"
    for name, text in told.items():
        ET.SubElement(ros, name).text = text
    return x.regular(1, "pose", STAMPS, 50.0, desc=desc, host=HOST)


def events(**clocks: Any) -> tuple[bytes, ...]:
    """One heartbeat of a node on the same computer, and what nobody can read."""
    identity = DeviceIdentity(NODE, f"{HOST}_ros_to_lsl")
    header = x.stream_header(
        2,
        lsl_name(identity, EVENTS.data_name),
        kind=EVENTS.content_type.value,
        fmt="string",
        source_id=source_id(identity, EVENTS.data_name),
        desc=describe(EVENTS, identity, DeviceInfo(model="ros_to_lsl")),
        host=HOST,
    )
    told = {"event": "heartbeat", "topics": {"/pose": {"clocks": clocks}, "/other": {}}}
    texts = [json.dumps(told), "{", "[1]", '{"topics": {"/pose": {"clocks": {"header": 1}}}}']
    values = x.samples(2, "string", [[each] for each in texts], [1001.0, 1002.0, 1003.0, 1004.0])
    return header, values, x.offsets(2, (1001.0, 1004.0)) + x.footer(2, len(texts))


@pytest.mark.parametrize(("clock", "edge_s"), [("synchronised", 0.0195), ("unknown", None)])
def test_a_clock_that_is_right_is_no_finding(clock: str, edge_s: float | None) -> None:
    assert not check(x.xdf(*robot(clock, edge_s))).findings


DOUBTS = [
    ("behind", 0.5, "may be behind by up to 0.500 s"),
    ("synchronised", 0.021, "may be behind by up to 0.021 s"),
    ("unsynchronised", None, "is not known to be right"),
    ("wrong", 0.5, "is wrong: about 0.500 s behind"),
    ("wrong", -0.005, "is 0.005 s ahead, at least"),
]


@pytest.mark.parametrize(("clock", "edge_s", "words"), DOUBTS)
def test_a_clock_that_may_be_off_is_a_warning(clock: str, edge_s: float | None, words: str) -> None:
    report = check(x.xdf(*robot(clock, edge_s, "arrival")))
    assert codes(report, Level.WARNING) == {("robot-clock", "pose")}
    text = text_of(report, "robot-clock", "pose")
    assert words in text
    assert "time of its arrival" in text


def test_what_is_found_later_stands_in_the_nodes_events() -> None:
    late = {"header": {"state": "behind", "edge_s": 0.25}}
    report = check(x.xdf(*robot("synchronised", 0.001), *events(**late)))
    assert "up to 0.250 s" in text_of(report, "robot-clock", "pose")
    right = {"header": {"state": "synchronised", "edge_s": 0.001}}
    assert not check(x.xdf(*robot("synchronised", 0.001), *events(**right))).findings


# A dead electrode of another program's amplifier is no signal.


def _eeg(values: list[list[float]], kind: str = "EEG", rate: float = RATE) -> bytes:
    stamps = _times(len(values), rate=rate)
    return x.xdf(
        x.stream_header(1, "amp", kind=kind, channels=len(values[0]), rate=rate),
        x.samples(1, "float32", values, stamps),
        x.offsets(1, (1005, 1010, 1015)),
        x.footer(1, len(values)),
    )


@pytest.mark.parametrize(
    ("kind", "seconds", "is_told"),
    [
        ("EEG", 15, True),
        ("EEG", 8, False),
        ("eda", 15, False),
        ("eda", 70, True),
        ("Gaze", 90, False),
    ],
)
def test_a_channel_of_another_program_that_does_not_change(
    kind: str, seconds: int, is_told: bool
) -> None:
    count = round(RATE) * (seconds + 10)
    values = [[float(k % 13), 5.0 if k >= 500 and k < 500 + seconds * RATE else float(k % 7)]
              for k in range(count)]  # fmt: skip
    report = check(_eeg(values, kind))
    told = [each for each in report.findings if each.code == "flat"]
    assert [each.level for each in told] == [Level.WARNING] * is_told
    if is_told:
        length = f"({seconds - 1}|{seconds}|{seconds + 1})"
        assert re.match(rf"channel 2 \(always 5\) has not changed for {length} s", told[0].text)


def test_a_channel_that_is_never_there_is_no_flat_one() -> None:
    values = [[math.nan, float(k % 13)] for k in range(3000)]
    assert "flat" not in {each.code for each in check(_eeg(values)).findings}


def test_streams_that_are_there_twice_are_one_event() -> None:
    stamps = _times(3000)
    streams = [
        x.regular(number, name, stamps, RATE, source_id=name, host="h")
        for number, name in enumerate(["a", "b", "a", "b"], 1)
    ]
    report = check(x.xdf(*(part for each in streams for part in each)))
    ((head, parts),) = by_event(report.findings)
    assert head.text == "2 streams each have the source_ids 'a', 'b'"
    assert [each.text for each in parts] == [f"2 streams have the name {each!r}" for each in "ab"]


def test_a_restart_is_not_told_again_for_each_stream() -> None:
    head = Finding(Level.WARNING, "restarted", "", "the agent was restarted between 4 s and 8 s")
    again = Finding(Level.WARNING, "restarted", "ecg", "once", part_of=head.text)
    gap = Finding(Level.WARNING, "gaps", "ecg", "1 gap", part_of=head.text)
    assert by_event([again, head, gap]) == [(head, [gap])]
    # One whose event is in no list stands for itself.
    assert by_event([again, gap]) == [(again, []), (gap, [])]


# A program that is away gives no answer, so the recorder repeats its last clock offset.
MEASURED_S = (1.23456789e-4, 1.31456781e-4, 1.19456788e-4, 1.27456783e-4)


class Sender(NamedTuple):
    """A stream without a rate, whose program is away from some clock offsets on."""

    name: str
    away: range  # Which of its clock offsets, each 5 s, repeat the one before.
    kind: str = "HR"
    host: str = "pc2"
    rate: float = 0.0
    step_s: float = 0.0  # What the recorder rounds its measurements to.
    sends: bool = False  # Whether its samples come nevertheless.


def _sent(senders: Sequence[Sender]) -> bytes:
    parts = [
        x.stream_header(n, each.name, kind=each.kind, rate=each.rate, host=each.host)
        for n, each in enumerate(senders, 1)
    ]
    kept = [MEASURED_S[0]] * len(senders)
    counts = [0] * len(senders)
    for place in range(13):
        for n, each in enumerate(senders):
            if place not in each.away:
                kept[n] = MEASURED_S[place % 4] + n * 1e-6 + place * 1e-8
                if each.step_s:
                    kept[n] = round(MEASURED_S[0] / each.step_s) * each.step_s
            parts.append(x.clock_offset(n + 1, 1000.0 + 5 * place, kept[n]))
            # Its last samples may come after its last answer.
            if each.sends or place not in each.away:
                stamps = [1000.5 + 5 * place + k for k in range(5)]
                parts.append(x.samples(n + 1, "float32", [[60.0 + k] for k in range(5)], stamps))
                counts[n] += 5
    return x.xdf(*parts, *(x.footer(n, count) for n, count in enumerate(counts, 1)))


WATCH = Sender("watch", range(5, 13))
HERE = Sender("gaze", range(0))


@pytest.mark.parametrize(
    ("senders", "said"),
    [
        ([WATCH], "19.5 s to the end: the program had ended or its network was away"),
        ([WATCH, HERE], "19.5 s to the end: the program had ended, so"),
        ([WATCH, HERE._replace(host="pc1")], "the program had ended or its network was away"),
        (
            [WATCH._replace(away=range(4, 7)), HERE],
            "34.5 s: the program had ended or stood still, so",
        ),
        ([Sender("marks", range(5, 13), "Markers")], "or its network was away"),
    ],
)
def test_a_program_that_was_away_is_said_where_no_rate_shows_it(
    senders: list[Sender], said: str
) -> None:
    report = check(_sent(senders))
    assert codes(report, Level.WARNING) >= {("no-answer", senders[0].name)}
    assert said in text_of(report, "no-answer", senders[0].name)
    assert verdict(report).colour is Colour.AMBER


def test_an_experiment_may_end_before_the_recording() -> None:
    report = check(_sent([Sender("marks", range(5, 13), "Markers"), HERE]))
    assert ("no-answer", "marks") in codes(report, Level.NOTE)


def test_streams_of_one_program_are_one_event() -> None:
    report = check(_sent([WATCH, WATCH._replace(name="state"), HERE]))
    (found,) = (each for each in report.findings if each.code == "no-answer")
    assert found.text.startswith("watch and state: no answer from 19.5 s")


def test_what_a_rate_shows_is_a_consequence() -> None:
    eeg = [WATCH._replace(name=name, rate=1.0, away=range(4, 8)) for name in ("eeg", "ppg")]
    report = check(_sent([*eeg, HERE]))
    ((cause, parts),) = by_event([e for e in report.findings if e.code in ("no-answer", "gaps")])
    assert cause.text.startswith("eeg and ppg: no answer from 14.5 s to 39.5 s")
    assert {(each.stream, each.code) for each in parts} == {("eeg", "gaps"), ("ppg", "gaps")}


def test_a_recording_lasts_as_long_as_its_recorder_went_on() -> None:
    report = check(_sent([WATCH._replace(name=name, rate=1.0) for name in ("eeg", "ppg")]))
    assert report.extent.length_s == pytest.approx(59.5, abs=0.1)
    ((cause, parts),) = by_event([e for e in report.findings if e.level is Level.WARNING])
    assert "to the end: the program had ended or its network was away" in cause.text
    assert {each.code for each in parts} == {"ends-early"}


@pytest.mark.parametrize(
    "sender",
    [
        WATCH._replace(away=range(0)),
        # Once a busy network gives no measurement either.
        WATCH._replace(away=range(5, 6)),
        # What a recorder has rounded repeats by chance.
        WATCH._replace(step_s=1e-6),
        WATCH._replace(step_s=1e-3),
        WATCH._replace(sends=True),
    ],
)
def test_nobody_is_called_away_without_need(sender: Sender) -> None:
    assert "no-answer" not in {code for code, _ in codes(check(_sent([sender, HERE])))}


def test_a_clock_that_is_noted_again_a_few_microseconds_early_was_not_restarted() -> None:
    offsets = [(1000.0, 4e-6), (1005.0, -4.7e-6), (1004.9999953, 0.0), (1004.9999953, 0.0)]
    report = check(_with_offsets([*offsets, (1026.0, 3e-6)]))
    assert only(report).figures.offsets.resets == 0
