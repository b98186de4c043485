"""Whether samples are missing: by the stamps of other programs, and by what the agent counted."""

from __future__ import annotations

import json
import math
import tracemalloc
from collections.abc import Collection, Mapping, Sequence
from itertools import accumulate
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.xdf.counters import (
    Reading,
    RecordedCounters,
    compare,
    parse_readings,
)
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.pace import Cuts, find_pace
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.verdict import judge
from biosensor_gateway.streaming.counters import Counters, counters_text
from tests.xdf import xdf_file as made
from tests.xdf.checking import check, codes, text_of
from tests.xdf.own_streams import own_header

# Stamps of other programs: bursts, overlaps and stalls are no gaps, and lost samples are.

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
    "a stall of exact stamps": stalled(measured(), 5000, 3.0),
    "a long stall of exact stamps": stalled(measured(), 5000, 12.0),
    "two stalls of exact stamps": stalled(stalled(measured(), 3000, 1.5), 5000, 3.0),
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


@pytest.mark.parametrize("real_hz", [250.0, 248.0])
@pytest.mark.parametrize("share", [0.001, 0.01, 0.05, 1 / 3, 0.5, 0.7])
def test_exact_stamps_tell_each_sample_that_is_lost_here_and_there(
    share: float, real_hz: float
) -> None:
    random = np.random.default_rng(5)
    is_kept = random.random(10_000) > share
    is_kept[[0, -1]] = True
    stamps = 1000.0 + np.arange(10_000)[is_kept] / real_hz
    found = find_pace(stamps, 250.0)
    assert sum(each.lost for each in found.holes) == np.count_nonzero(~is_kept)
    assert 1 / found.period_s == pytest.approx(real_hz)
    # A chunk that was written twice, and a clock that was set back, hide none of them.
    half = len(stamps) // 2
    for again in (stamps[half - 50 :], stamps[half:] - 7.0):
        other = find_pace(np.concatenate([stamps[:half], again]), 250.0)
        assert other.turns == (half,)
        assert len(other.holes) == pytest.approx(len(found.holes), abs=50)


@pytest.mark.parametrize("size", [130, 512])
@pytest.mark.parametrize("delay_s", [0.002, 0.1])
def test_packets_that_come_late_lose_no_sample(size: int, delay_s: float) -> None:
    """Within a packet stamps are exact, so that only the first of each is uneven."""
    late = np.repeat(np.random.default_rng(6).exponential(delay_s, 40), size)
    stamps = 1000.0 + np.arange(40 * size) / 250.0 + late
    assert find_pace(stamps, 250.0).holes == ()


@pytest.mark.parametrize("nominal_hz", [0.25, 250_000.0])
def test_a_header_that_is_off_by_a_thousand_hides_nothing(nominal_hz: float) -> None:
    stamps = 1000.0 + np.arange(5000) / 250.0
    stamps[3000:] += 4.0
    found = find_pace(stamps, nominal_hz)
    assert found.burst == 1
    assert [each.lost for each in found.holes] == [1000]
    assert 1 / found.period_s == pytest.approx(250.0)


def test_stamps_that_hardly_differ_are_no_traceback() -> None:
    """Whole numbers read as floats, as of a sender that stamps in nanoseconds."""
    stamps = (np.arange(5000, dtype=np.int64) * 4_000_000 + 5_000_000_000).view(np.float64)
    for count in (12, 5000):
        report = check(
            made.xdf(
                made.stream_header(1, "ecg", kind="ECG", rate=250.0),
                made.samples(1, "float32", [[0.0]] * count, stamps[:count].tolist()),
                made.footer(1, count),
            )
        )
        (measured_stream,) = report.streams
        assert measured_stream.figures.rate_hz is None
    assert text_of(report, "wrong-clock", "ecg").startswith("its stamps are all the same")


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


SEVERAL = {
    **{name: HARMLESS[name] for name in ("exact", "delayed bursts", "overlaps", "a fast clock")},
    **{name: without(*LOSSES[name]) for name in ("many holes", "three bursts")},
    "set back": measured() - 100.0 * (np.arange(COUNT) > 5000),
    "garbage at the end": np.append(measured(), 8e5),
    "a stray and a bad stamp": np.where(
        np.isin(np.arange(COUNT), (3900, 9000)), [[3e5], [np.nan]], measured()
    )[np.arange(COUNT) // 5000 % 2, np.arange(COUNT)],
}


@pytest.mark.parametrize("name", SEVERAL)
def test_a_long_stream_is_judged_in_sections_as_in_one(name: str) -> None:
    stamps = SEVERAL[name]
    cuts = Cuts(NOMINAL_HZ, section=4096)
    for block in np.array_split(stamps, 50):
        cuts.take(block)
    cuts.end()
    whole, found = find_pace(stamps, NOMINAL_HZ), cuts.pace
    assert found is not None
    assert found.period_s == pytest.approx(whole.period_s, rel=5e-5)
    assert [each.at for each in found.holes] == [each.at for each in whole.holes]
    assert [each.after_s for each in found.holes] == [stamps[each.at - 1] for each in whole.holes]
    told = (found.turns, found.odd_steps, found.stray, found.ends_astray, found.burst)
    assert told == (whole.turns, whole.odd_steps, whole.stray, whole.ends_astray, whole.burst)


def _peak(count: int, path: Path) -> int:
    """Return how many bytes a check needs of a stream with so many delayed samples."""
    stamps = measured(count) + delays(count) / 10
    rows = np.zeros(count, np.dtype([("size", "u1"), ("stamp", "<f8"), ("value", "<f4")]))
    rows["size"], rows["stamp"] = 8, stamps
    with path.open("wb") as file:
        file.write(made.xdf(made.stream_header(1, "a", kind="ECG", rate=NOMINAL_HZ)))
        for part in np.array_split(rows, count // 5000):
            number = b"\x01\0\0\0\x04" + len(part).to_bytes(4, "little")
            file.write(made.chunk(3, number + part.tobytes()))
        file.write(made.footer(1, count))
    tracemalloc.start()
    report = judge(read_recording(path))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert text_of(report, "overlaps", "a").endswith("; 129.8 Hz; nothing seems lost")
    return peak


def test_a_long_stream_needs_no_more_memory_than_a_short_one(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    assert _peak(1_200_000, path) < 1.1 * _peak(300_000, path)


def test_without_room_for_a_temporary_file_stamps_stay_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(**_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    path = tmp_path / "study.xdf"
    _peak(300_000, path)
    (stream,) = read_recording(path).streams
    assert stream.stamps == pytest.approx(measured(300_000) + delays(300_000) / 10)


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
    assert text == "timestamps in bursts of 73, each 0.56 s; 129.8 Hz; nothing seems lost"
    report = check(_file(overlaps(delays(200))))
    assert codes(report, Level.ERROR) == set()
    assert "its stamps overlap by up to" in text_of(report, "overlaps", "a")
    report = check(_file(without(bursts(delays(200)), [50 * BURST], 3 * BURST)))
    assert "1 gap of" in text_of(report, "gaps", "a")
    assert "about 21" in text_of(report, "gaps", "a")
    assert text_of(report, "bursts", "a").endswith("; other samples are lost")


# What the agent counted, against what the file holds.
RATE, SECONDS = 130, 30
AGENT = DeviceIdentity("gateway", "lab-pc")
STRAP = DeviceIdentity("polar_h10", "A1B2")
ECG = source_id(STRAP, "ecg")
STAMPS = [1000 + k / RATE for k in range(RATE * SECONDS)]


def _end(stream_id: int, count: int) -> bytes:
    return made.offsets(stream_id, (1005, 1010, 1015)) + made.footer(stream_id, count)


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


def _counted(
    stamps: list[float],
    counted: list[Mapping[str, Counters]] | None,
    off: Collection[str] = (),
    late_s: float = 0.0,
    lacking: Mapping[str, Sequence[str]] | None = None,
    value: float = 1.0,
) -> bytes:
    parts = [
        own_header(1, STRAP, "ecg"),
        made.samples(1, "float32", [[value]] * len(stamps), [*stamps]) if stamps else b"",
        _end(1, len(stamps)),
    ]
    if counted is not None:
        texts = [[counters_text(counters, off=off, lacking=lacking)] for counters in counted]
        times = [
            1001.0 + k + (late_s if k == 10 or (k > 10 and late_s > 1) else 0)
            for k in range(len(texts))
        ]
        parts += [own_header(2, AGENT, "counters"), made.samples(2, "string", texts, times)]
        parts += [_end(2, len(texts))]
    return made.xdf(*parts)


def test_all_that_was_pushed_is_there() -> None:
    report = check(_counted(STAMPS, [*_counted_each_second()]))
    assert not report.findings
    assert report.streams[0].counters == RecordedCounters(RATE * 29, RATE * 29, 0)
    assert report.streams[0].stream.header.is_ours


def test_as_many_samples_of_another_stream_are_not_those_that_were_counted() -> None:
    """One stream's inlet goes on with another agent, and that of its events does not."""
    begin = 15 * RATE
    others = [each - 0.003 for each in STAMPS[begin:]]
    report = check(_counted(STAMPS[:begin] + others, [*_counted_each_second()]))
    name = lsl_name(STRAP, "ecg")
    assert codes(report, Level.ERROR) == {("another-agent", name)}
    assert text_of(report, "another-agent", name).startswith("from 16.0 s on its samples are not")


def test_what_the_recorder_lost_is_an_error() -> None:
    report = check(_counted(STAMPS[:1000] + STAMPS[1100:], [*_counted_each_second()]))
    name = lsl_name(STRAP, "ecg")
    assert codes(report, Level.ERROR) == {("not-recorded", name)}
    assert text_of(report, "not-recorded", name).startswith("100 of 3770 samples")
    assert ("gaps", name) in codes(report, Level.WARNING)


@pytest.mark.parametrize(
    ("late_s", "level", "said"),
    [
        (0.4, None, ""),
        (0.6, Level.NOTE, "1.6 s apart at 10.0 s, as on a busy computer; nothing is missing"),
        (1.5, Level.WARNING, "2.5 s apart at 10.0 s, as on a busy computer; streams without"),
    ],
)
def test_a_report_that_comes_late_is_no_gap(late_s: float, level: Level | None, said: str) -> None:
    report = check(_counted(STAMPS, [*_counted_each_second()], late_s=late_s))
    counters = lsl_name(AGENT, "counters")
    assert codes(report) == ({("held-up", counters)} if level else set())
    if level:
        assert codes(report, level) == {("held-up", counters)}
        assert said in text_of(report, "held-up", counters)


def test_what_the_device_lost_is_a_warning() -> None:
    report = check(_counted(STAMPS, [*_counted_each_second(lost=40)]))
    assert codes(report) == {("lost", lsl_name(STRAP, "ecg"))}
    assert report.is_good


def test_more_samples_than_were_pushed() -> None:
    report = check(_counted(STAMPS, [*_counted_each_second(more=-5)]))
    assert codes(report, Level.ERROR) == {("too-many", lsl_name(STRAP, "ecg"))}


def test_pushed_and_nothing_recorded() -> None:
    report = check(_counted([], [*_counted_each_second()]))
    name = lsl_name(STRAP, "ecg")
    assert ("not-recorded", name) in codes(report, Level.ERROR)


def test_what_the_settings_switch_off_is_not_missing() -> None:
    counted = [{ECG: Counters()} for _ in range(SECONDS)]
    report = check(_counted([], [*counted], off={ECG}))
    assert report.is_good
    assert codes(report) == {("off", lsl_name(STRAP, "ecg"))}
    assert codes(check(_counted([], [*counted])), Level.ERROR) == {
        ("no-samples", lsl_name(STRAP, "ecg"))
    }


@pytest.mark.parametrize(
    ("lacking", "code", "is_good"),
    [
        ({ECG: ["ECG"]}, "off", True),
        ({ECG: ["Other"]}, "no-values", False),
        ({}, "no-values", False),
    ],
)
def test_a_channel_that_the_model_does_not_have_is_not_missing(
    lacking: Mapping[str, Sequence[str]], code: str, *, is_good: bool
) -> None:
    content = _counted(STAMPS, [*_counted_each_second()], lacking=lacking, value=math.nan)
    report = check(content)
    name = lsl_name(STRAP, "ecg")
    level = Level.NOTE if is_good else Level.WARNING
    assert codes(report, level) == codes(report) == {(code, name)}
    assert text_of(report, code, name).endswith(" ECG")


def test_what_was_pushed_is_missing_also_where_it_was_switched_off() -> None:
    report = check(_counted([], [*_counted_each_second()], off={ECG}))
    assert ("not-recorded", lsl_name(STRAP, "ecg")) in codes(report, Level.ERROR)


def test_without_counters_it_says_so() -> None:
    assert codes(check(_counted(STAMPS, None))) == {("no-counters", "")}


def test_a_stream_that_was_left_out() -> None:
    counted = [{**each, "other": each[ECG]} for each in _counted_each_second()]
    report = check(_counted(STAMPS, [*counted]))
    assert codes(report, Level.ERROR) == {("left-out", lsl_name(AGENT, "counters"))}


def test_the_streams_of_a_device_that_was_left_out_are_one_finding() -> None:
    others = ("P2@polar_h10-ecg", "P2@polar_h10-acc")
    counted = [{**each, **dict.fromkeys(others, each[ECG])} for each in _counted_each_second()]
    text = text_of(check(_counted(STAMPS, [*counted])), "left-out", lsl_name(AGENT, "counters"))
    assert text == "the agent also had P2@polar_h10, of which ecg and acc were not recorded"


def test_counters_of_another_computer_do_not_count() -> None:
    content = _counted(STAMPS, [*_counted_each_second()])
    assert content.count(b"<hostname>host<") == 2
    other = content.replace(b"<hostname>host<", b"<hostname>tsoh<", 1)
    report = check(other)
    assert report.streams[0].counters is None
    assert ("left-out", lsl_name(AGENT, "counters")) in codes(report)


def test_counters_that_cannot_be_read() -> None:
    texts = [["{"], ["[]"], ['{"a": 1}'], ['{"a": {"pushed": 1, "lost": 0, "last_stamp": NaN}}']]
    content = made.xdf(
        own_header(1, AGENT, "counters"),
        made.samples(1, "string", texts, [1.0, 2, 3, 4]),
        _end(1, 4),
    )
    assert "4 of its samples" in text_of(check(content), "counters", lsl_name(AGENT, "counters"))


def test_a_header_that_lies_is_not_ours() -> None:
    told, lied = (f"<source_id>{name}<".encode() for name in (ECG, ECG[::-1]))
    content = _counted(STAMPS, None)
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


def test_after_a_restart_what_is_sent_as_seldom_as_before_is_not_too_much() -> None:
    def text(ecg: int, events: int, marker: float) -> str:
        told = {"ecg": (ecg, float(ecg)), "markers": (1, marker), "events": (events, marker)}
        return json.dumps(
            {
                source: {"pushed": pushed, "lost": 0, "last_stamp": stamp}
                for source, (pushed, stamp) in told.items()
            }
        )

    # The second agent has sent one marker, too, and more events than the first.
    texts = [text(100, 1, 5.0), text(200, 1, 5.0), text(90, 2, 50.0), text(190, 2, 50.0)]
    readings, _ = parse_readings(texts)
    assert [each.run for each in readings["markers"]] == [0, 0, 1, 1]
    assert [each.run for each in readings["events"]] == [0, 0, 1, 1]
    compared = compare(readings["markers"], np.array([5.0, 50.0]), 60.0)
    assert (compared.pushed, compared.held, compared.restarts) == (0, 0, 1)


def test_a_beat_that_is_told_of_late_and_at_the_stop_is_not_missing() -> None:
    """A wristband tells of a beat six seconds later; what came in the last 0.5 s is in no file."""
    beats = [100.0 + k for k in range(30)]
    readings = [Reading(5 + k, 0, beats[k], told_at=beats[k] + 6.0) for k in range(30)]
    end = beats[-1] + 6.0
    assert compare(readings, np.array(beats[:-1]), end) == RecordedCounters(28, 28, 0)
    # What had three seconds to come is missing.
    assert compare(readings, np.array(beats[:-4]), end) == RecordedCounters(26, 25, 0)
