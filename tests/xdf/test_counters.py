"""What the agent counted, against what the file holds."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import accumulate

import numpy as np
import pytest

from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.xdf.counters import (
    Reading,
    RecordedCounters,
    compare,
    parse_readings,
)
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.streaming.counters import Counters, counters_text
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes, text_of
from tests.xdf.own_streams import own_header

RATE, SECONDS = 130, 30
AGENT = DeviceIdentity("gateway", "lab-pc")
STRAP = DeviceIdentity("polar_h10", "A1B2")
ECG = source_id(STRAP, "ecg")
STAMPS = [1000 + k / RATE for k in range(RATE * SECONDS)]


def _end(stream_id: int, count: int) -> bytes:
    return x.offsets(stream_id, (1005, 1010, 1015)) + x.footer(stream_id, count)


def _counted_each_second(*, lost: int = 0, more: int = 0) -> list[dict[str, Counters]]:
    """What the agent says of the stream from second 1 on; `more` is pushed in second 10."""
    return [
        {
            ECG: Counters(
                pushed=5000 + RATE * second + (more if second >= 10 else 0),
                lost=lost if second >= 10 else 0,
                last_stamp=STAMPS[RATE * second - 1],
            )
        }
        for second in range(1, SECONDS + 1)
    ]


def _file(
    stamps: list[float],
    counted: list[Mapping[str, Counters]] | None,
    off: Collection[str] = (),
    late_s: float = 0.0,
) -> bytes:
    parts = [
        own_header(1, STRAP, "ecg"),
        x.samples(1, "float32", [[1.0]] * len(stamps), [*stamps]) if stamps else b"",
        _end(1, len(stamps)),
    ]
    if counted is not None:
        texts = [[counters_text(counters, off=off)] for counters in counted]
        times = [
            1001.0 + k + (late_s if k == 10 or (k > 10 and late_s > 1) else 0)
            for k in range(len(texts))
        ]
        parts += [own_header(2, AGENT, "counters"), x.samples(2, "string", texts, times)]
        parts += [_end(2, len(texts))]
    return x.xdf(*parts)


def test_all_that_was_pushed_is_there() -> None:
    report = check(_file(STAMPS, [*_counted_each_second()]))
    assert not report.findings
    assert report.streams[0].counters == RecordedCounters(RATE * 29, RATE * 29, 0)
    assert report.streams[0].stream.header.is_ours


def test_what_the_recorder_lost_is_an_error() -> None:
    report = check(_file(STAMPS[:1000] + STAMPS[1100:], [*_counted_each_second()]))
    name = lsl_name(STRAP, "ecg")
    assert codes(report, Level.ERROR) == {("not-recorded", name)}
    assert text_of(report, "not-recorded", name).startswith("100 of 3770 samples")
    assert ("gaps", name) in codes(report, Level.WARNING)


@pytest.mark.parametrize(
    ("late_s", "level", "said"),
    [
        (0.4, None, ""),
        (0.6, Level.NOTE, "1.6 s apart at 10.0 s, as on a busy computer; nothing is missing"),
        (1.5, Level.WARNING, "2.5 s apart at 10.0 s, as on a busy computer; what has no clock"),
    ],
)
def test_a_report_that_comes_late_is_no_gap(late_s: float, level: Level | None, said: str) -> None:
    report = check(_file(STAMPS, [*_counted_each_second()], late_s=late_s))
    counters = lsl_name(AGENT, "counters")
    assert codes(report) == ({("held-up", counters)} if level else set())
    if level:
        assert codes(report, level) == {("held-up", counters)}
        assert said in text_of(report, "held-up", counters)


def test_what_the_device_lost_is_a_warning() -> None:
    report = check(_file(STAMPS, [*_counted_each_second(lost=40)]))
    assert codes(report) == {("lost", lsl_name(STRAP, "ecg"))}
    assert report.is_good


def test_more_samples_than_were_pushed() -> None:
    report = check(_file(STAMPS, [*_counted_each_second(more=-5)]))
    assert codes(report, Level.ERROR) == {("too-many", lsl_name(STRAP, "ecg"))}


def test_pushed_and_nothing_recorded() -> None:
    report = check(_file([], [*_counted_each_second()]))
    name = lsl_name(STRAP, "ecg")
    assert ("not-recorded", name) in codes(report, Level.ERROR)


def test_what_the_settings_switch_off_is_not_missing() -> None:
    counted = [{ECG: Counters()} for _ in range(SECONDS)]
    report = check(_file([], [*counted], off={ECG}))
    assert report.is_good
    assert codes(report) == {("off", lsl_name(STRAP, "ecg"))}
    assert codes(check(_file([], [*counted])), Level.ERROR) == {
        ("no-samples", lsl_name(STRAP, "ecg"))
    }


def test_what_was_pushed_is_missing_also_where_it_was_switched_off() -> None:
    report = check(_file([], [*_counted_each_second()], off={ECG}))
    assert ("not-recorded", lsl_name(STRAP, "ecg")) in codes(report, Level.ERROR)


def test_without_counters_it_says_so() -> None:
    assert codes(check(_file(STAMPS, None))) == {("no-counters", "")}


def test_a_stream_that_was_left_out() -> None:
    counted = [{**each, "other": each[ECG]} for each in _counted_each_second()]
    report = check(_file(STAMPS, [*counted]))
    assert codes(report, Level.ERROR) == {("left-out", lsl_name(AGENT, "counters"))}


def test_the_streams_of_a_device_that_was_left_out_are_one_finding() -> None:
    others = ("P2@polar_h10-ecg", "P2@polar_h10-acc")
    counted = [{**each, **dict.fromkeys(others, each[ECG])} for each in _counted_each_second()]
    text = text_of(check(_file(STAMPS, [*counted])), "left-out", lsl_name(AGENT, "counters"))
    assert text == "the agent also had P2@polar_h10, of which ecg and acc were not recorded"


def test_counters_of_another_computer_do_not_count() -> None:
    content = _file(STAMPS, [*_counted_each_second()])
    assert content.count(b"<hostname>host<") == 2
    other = content.replace(b"<hostname>host<", b"<hostname>tsoh<", 1)
    report = check(other)
    assert report.streams[0].counters is None
    assert ("left-out", lsl_name(AGENT, "counters")) in codes(report)


def test_counters_that_cannot_be_read() -> None:
    texts = [["{"], ["[]"], ['{"a": 1}'], ['{"a": {"pushed": 1, "lost": 0, "last_stamp": NaN}}']]
    content = x.xdf(
        own_header(1, AGENT, "counters"), x.samples(1, "string", texts, [1.0, 2, 3, 4]), _end(1, 4)
    )
    assert "4 of its samples" in text_of(check(content), "counters", lsl_name(AGENT, "counters"))


def test_a_header_that_lies_is_not_ours() -> None:
    told, lied = (f"<source_id>{name}<".encode() for name in (ECG, ECG[::-1]))
    content = _file(STAMPS, None)
    assert content.count(told) == 1
    content = content.replace(told, lied)
    report = check(content)
    assert not report.streams[0].stream.header.is_ours
    assert "another source_id" in text_of(report, "refused-header", lsl_name(STRAP, "ecg"))


def test_readings_are_what_the_agent_writes() -> None:
    readings, unreadable = parse_readings(
        [counters_text({"a": Counters(3, 1, 9, 2.5)}), counters_text({"a": Counters(4, 1, 9, 3.5)})]
    )
    assert readings == {"a": [Reading(3, 1, 2.5), Reading(4, 1, 3.5)]}
    assert not unreadable


def _readings(pushed: list[int], stamps: list[float], lost: int = 0) -> list[Reading]:
    return [Reading(p, lost, s) for p, s in zip(pushed, stamps, strict=True)]


def test_comparing_begins_where_the_recording_of_the_stream_begins() -> None:
    # Five were pushed before the recorder was attached to this stream.
    readings = _readings([0, 5, 8, 12], [0.0, 5.0, 8.0, 12.0])
    assert compare(readings, np.arange(7.0, 13.0), 100.0) == RecordedCounters(4, 4, 0)


@pytest.mark.parametrize(("end", "missing"), [(13.0, 0), (16.9, 4)])
def test_only_what_came_right_before_the_end_may_be_missing(end: float, missing: int) -> None:
    readings = _readings([1, 8, 12], [1.0, 8.0, 12.0])
    compared = compare(readings, np.arange(1.0, 9.0), end)
    assert compared.pushed - compared.held == missing


@pytest.mark.parametrize(("pushed", "held"), [(2, 2), (3, 2), (1, 1), (0, 1)])
def test_a_reading_may_come_between_events_of_one_moment(pushed: int, held: int) -> None:
    """Two events at 1 s: the first reading may have come before or after the second of them."""
    readings = _readings([10, 10 + pushed], [1.0, 2.0])
    compared = compare(readings, np.array([1.0, 1.0, 2.0]), 100.0)
    assert compared == RecordedCounters(pushed, held, 0)


def test_an_agent_that_was_started_again() -> None:
    counts = [*accumulate([4] * 5), *accumulate([4] * 5)]
    stamps = [4.0 * (k + 1) for k in range(5)] + [40 + 4.0 * (k + 1) for k in range(5)]
    held = np.concatenate([np.arange(1.0, 21.0), np.arange(41.0, 61.0)])
    assert compare(_readings(counts, stamps), held, 100.0) == RecordedCounters(
        32, 32, 0, restarts=1
    )
    assert compare(_readings(counts, stamps), np.delete(held, [7, 30]), 100.0).held == 30


def test_a_beat_that_is_told_of_late_and_at_the_stop_is_not_missing() -> None:
    """A wristband tells of a beat six seconds later; what came in the last 0.5 s is in no file."""
    beats = [100.0 + k for k in range(30)]
    readings = [Reading(5 + k, 0, beats[k], told_at=beats[k] + 6.0) for k in range(30)]
    end = beats[-1] + 6.0
    assert compare(readings, np.array(beats[:-1]), end) == RecordedCounters(28, 28, 0)
    # What had three seconds to come is missing.
    assert compare(readings, np.array(beats[:-4]), end) == RecordedCounters(26, 25, 0)
