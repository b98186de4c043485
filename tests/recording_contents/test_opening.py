"""What is in a recording, piece by piece, on the clock of the recorder."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.xdf.figures import summarise_offsets
from biosensor_gateway.recording.xdf.sender_clock import SenderClock
from tests.xdf import xdf_file as made
from tests.xdf.own_streams import description

# What is in a recording, piece by piece, on one clock, and what time of day it was.

DAY_NS = 1_790_000_000_000_000_000


def _events(stream_id: int, sensor: str, pairs: dict[float, int]) -> bytes:
    texts = [
        [json.dumps({"event": "heartbeat", "clock": {"lsl_s": at, "unix_ns": unix_ns}})]
        for at, unix_ns in pairs.items()
    ]
    header = made.stream_header(
        stream_id,
        f"{sensor}/events",
        fmt="string",
        source_id=source_id(DeviceIdentity(sensor, "u1"), "events"),
        desc=description(sensor, "events"),
    )
    return header + made.samples(stream_id, "string", texts, [at + 0.01 for at in pairs])


def _numbers(stream_id: int, name: str, first_s: float, count: int, **header: object) -> bytes:
    values = np.arange(2 * count, dtype=float).reshape(-1, 2)
    stamps = first_s + np.arange(count) / 4.0
    parts = [made.stream_header(stream_id, name, channels=2, rate=4.0, **header)]  # type: ignore[arg-type]
    parts += [
        made.samples(stream_id, "float32", values[at : at + 4].tolist(), list(stamps[at : at + 4]))
        for at in range(0, count, 4)
    ]
    return b"".join(parts)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "study.xdf"


def test_every_sample_comes_on_the_recorders_clock(path: Path) -> None:
    content = _numbers(1, "a", 100.0, 40) + made.offsets(1, (100.0, 105.0, 110.0), 7.0)
    path.write_bytes(made.xdf(content))
    with open_contents(path) as contents:
        (stream,) = contents.streams
        blocks = list(stream.blocks())
    assert (contents.begin_s, contents.end_s) == (107.0, 116.75)
    assert np.concatenate([each.stamps for each in blocks]).tolist() == [
        100.0 + n / 4 for n in range(40)
    ]
    assert np.concatenate([each.times for each in blocks])[0] == pytest.approx(107.0)
    assert np.concatenate([np.asarray(each.values) for each in blocks])[-1].tolist() == [78, 79]


def test_units_are_kept_of_a_header_that_is_not_believed_to_be_ours(path: Path) -> None:
    desc = description("zephyr", "ecg")
    block = desc.find("biosensor")
    assert block is not None
    block[0].text = "99"
    channel = ET.SubElement(ET.SubElement(desc, "channels"), "channel")
    ET.SubElement(channel, "unit").text = "millivolts"
    header = made.stream_header(1, "a", rate=250.0, desc=desc)
    path.write_bytes(made.xdf(header + made.samples(1, "float32", [[0.5]], [100.0])))
    with open_contents(path) as contents:
        (stream,) = contents.streams
        assert stream.header.refused
        assert stream.meaning.units == ("millivolts",)


def test_stamps_that_were_left_out_are_the_same_when_read_alone(path: Path) -> None:
    path.write_bytes(b"".join(made.two_streams()))
    with open_contents(path) as contents:
        numbers, events = contents.streams
        whole = np.concatenate([each.times for each in numbers.blocks()])
        late = np.concatenate([each.times for each in numbers.blocks(30.0, 31.0)])
        texts = [text for each in events.blocks() for (text,) in each.values]
    assert late.tolist() == whole[(whole >= 30.0) & (whole < 31.0)].tolist()
    assert texts == [f"event {k}" for k in range(40)]


def test_many_streams_come_in_the_order_of_time(path: Path) -> None:
    parts = _numbers(1, "a", 100.0, 40) + _numbers(2, "b", 103.1, 40)
    path.write_bytes(made.xdf(parts))
    with open_contents(path) as contents:
        merged = [(s.number, float(b.times[0])) for s, b in choose(contents, Selection()).merged()]
    assert [first for _, first in merged] == sorted(first for _, first in merged)
    assert {number for number, _ in merged} == {1, 2}


def test_a_damage_costs_only_what_it_hit(path: Path) -> None:
    content = made.xdf(_numbers(1, "a", 100.0, 400))
    path.write_bytes(content[:3000] + b"\xff" * 40 + content[3040:])
    with open_contents(path) as contents:
        (stream,) = contents.streams
        count = sum(len(each) for each in stream.blocks())
    assert len(contents.damages) == 1
    assert count == stream.sample_count
    assert 380 <= count < 400


def test_the_node_tells_the_time_of_day_to_the_microsecond(path: Path) -> None:
    lsl_s = [100.0 + 5 * n for n in range(5)]
    node = {at: DAY_NS + round(at * 1e9) + 20_000 * n for n, at in enumerate(lsl_s)}
    agent = {at: DAY_NS + 77 + round(at * 1e9) for at in lsl_s}
    content = _events(1, "gateway", agent) + _events(2, "lsl_to_ros", node)
    path.write_bytes(made.xdf(content + made.offsets(2, (100.0, 110.0, 120.0), 3.0)))
    with open_contents(path) as contents:
        wall = contents.wall
    assert wall is not None
    assert (wall.source, wall.resolution_s) == ("lsl_to_ros/events", 0.0)
    # Between the first and the second pair, 3 s later on the recorder's clock.
    (found,) = wall.to_unix_ns(np.array([105.5])).tolist()
    assert found == pytest.approx(DAY_NS + 102_500_000_000 + 10_000, abs=1000)
    assert wall.to_lsl_s(found) == pytest.approx(105.5, abs=1e-6)


@pytest.mark.parametrize("damaged", [10**400, 1e308, float("nan")], ids=["int", "float", "nan"])
def test_a_pair_that_no_clock_can_have_is_passed_over(path: Path, damaged: float) -> None:
    told = [
        {"event": "heartbeat", "clock": {"lsl_s": at, "unix_ns": DAY_NS}} for at in (damaged, 100)
    ]
    samples = made.samples(1, "string", [[json.dumps(each)] for each in told], [99.0, 100.0])
    path.write_bytes(made.xdf(_events(1, "gateway", {}) + samples))
    with open_contents(path) as contents:
        assert contents.wall is not None
        assert contents.wall.to_unix_ns(np.array([101.0])).tolist() == [DAY_NS + 10**9]


def test_a_clock_that_was_set_is_another_from_then_on(path: Path) -> None:
    pairs = {100.0: DAY_NS, 105.0: DAY_NS + 65_000_000_000, 110.0: DAY_NS + 70_000_000_000}
    path.write_bytes(made.xdf(_events(1, "gateway", pairs)))
    with open_contents(path) as contents:
        assert contents.wall is not None
        found = contents.wall.to_unix_ns(np.array([99.0, 104.9, 105.0, 200.0])) - DAY_NS
        # Exports with times of day say so.
        assert contents.wall.doubt.startswith("jumps by +60.0 s: a computer slept meanwhile, or")
    assert found.tolist() == pytest.approx([-1e9, 4.9e9, 65e9, 160e9], abs=1000)


def test_without_pairs_there_is_the_date_of_the_recorder(path: Path) -> None:
    header = b"<?xml version='1.0'?><info><datetime>2026-03-14T10:30:00+0100</datetime></info>"
    path.write_bytes(b"XDF:" + made.chunk(1, header) + _numbers(1, "a", 100.0, 8))
    with open_contents(path) as contents:
        assert contents.wall is not None
        assert contents.wall.resolution_s == 1.0
        (found,) = contents.wall.to_unix_ns(np.array([101.0])).tolist()
    begun = datetime(2026, 3, 14, 9, 30, 1, tzinfo=UTC).timestamp()
    assert found == int(begun * 1e9)


def test_a_date_without_a_zone_may_be_hours_off(path: Path) -> None:
    header = b"<?xml version='1.0'?><info><datetime>2026-03-14T10:30:00</datetime></info>"
    path.write_bytes(b"XDF:" + made.chunk(1, header) + _numbers(1, "a", 100.0, 8))
    with open_contents(path) as contents:
        assert contents.wall is not None
        assert contents.wall.resolution_s > 3600.0
        assert "hours" in contents.wall.doubt


@pytest.mark.parametrize(
    ("begin", "end", "expected"),
    [
        ("", "", 40),
        ("1", "2", 4),
        ("0:05", "0:06.5", 6),
        ("0:00:09", "", 4),
        ("2026-09-21T14:13:25+00:00", "", 20),
    ],
)
def test_a_span_of_time_is_cut_out(path: Path, begin: str, end: str, expected: int) -> None:
    unix_ns = round(datetime(2026, 9, 21, 14, 13, 20, tzinfo=UTC).timestamp()) * 1_000_000_000
    path.write_bytes(
        made.xdf(_numbers(1, "a", 100.0, 40) + _events(2, "gateway", {100.0: unix_ns}))
    )
    with open_contents(path) as contents:
        chosen = choose(contents, Selection(streams=["a"], begin=begin, end=end))
        found = sum(len(each) for each in chosen.samples(chosen.streams[0]))
    # The recording begins with the event, which is 10 ms before the numbers' second sample.
    assert found == expected


def test_one_person_can_be_cut_out(path: Path) -> None:
    content = b"".join(
        _numbers(
            n,
            f"polar_h10/{n}/ecg",
            100.0,
            8,
            source_id=source_id(DeviceIdentity("polar_h10", "u1", who), "ecg"),
            desc=description("polar_h10", "ecg", who),
        )
        for n, who in enumerate(("P1", "P2", ""), 1)
    )
    path.write_bytes(made.xdf(content))
    with open_contents(path) as contents:
        assert [each.number for each in choose(contents, Selection(participant="P2")).streams] == [
            2
        ]
        assert [each.number for each in choose(contents, Selection(without="P2")).streams] == [1, 3]
        assert len(choose(contents, Selection(streams=["polar_*/ecg"])).streams) == 3


@pytest.mark.parametrize(
    ("selection", "words"),
    [
        (Selection(streams=["b*"]), "no stream 'b*'"),
        (Selection(participant="P9"), "no participant is called 'P9'"),
        (Selection(without="P9"), "no participant is called 'P9'"),
        (Selection(begin="soon"), "'soon' is not a time"),
        (Selection(begin="5", end="4"), "is not after"),
        (Selection(begin="2026-03-14T10:30:00"), "does not contain the time of day"),
    ],
)
def test_a_wrong_wish_is_one_sentence(path: Path, selection: Selection, words: str) -> None:
    path.write_bytes(made.xdf(_numbers(1, "a", 100.0, 8)))
    with (
        open_contents(path) as contents,
        pytest.raises(ConfigError, match=re.escape(words)) as caught,
    ):
        choose(contents, selection)
    assert caught.value.reason is ConfigReason.WRONG_VALUE
    assert "\n" not in str(caught.value)


# Stamps on the clock of the recorder.
def _offsets(
    begin_s: float, count: int, offset_s: float, ppm: float, noise: np.ndarray
) -> list[tuple[float, float]]:
    times = begin_s + 5.0 * np.arange(count)
    values = offset_s + ppm * 1e-6 * (times - begin_s) + noise
    return list(zip(times.tolist(), values.tolist(), strict=True))


def test_without_offsets_stamps_stay() -> None:
    stamps = np.array([1.0, 2.0])
    clock = SenderClock([])
    assert not clock.is_known
    assert clock.to_recorder(stamps).tolist() == stamps.tolist()


@pytest.mark.parametrize("damaged", [1e200, -1e12, np.inf, np.nan])
@pytest.mark.parametrize("place", [0, 1])
def test_what_no_clock_can_read_is_passed_over(damaged: float, place: int) -> None:
    offsets = _offsets(100.0, 20, 3.0, 0.0, np.zeros(20))
    wrong = list(offsets[10])
    wrong[place] = damaged
    clock = SenderClock([*offsets[:10], (wrong[0], wrong[1]), *offsets[10:]])
    assert clock.restarts == 0
    assert clock.to_recorder(np.array([150.0]), offsets_before=12).tolist() == [153.0]
    assert not SenderClock([(wrong[0], wrong[1])]).is_known


@given(
    st.floats(0, 1e6),
    st.integers(20, 400),
    st.floats(-1e5, 1e5),
    st.floats(-200, 200),
    st.integers(0, 2**32),
)
def test_a_clock_that_drifts_is_followed_in_spite_of_a_busy_network(
    begin_s: float, count: int, offset_s: float, ppm: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    noise = random.normal(0, 50e-6, count)
    late = random.choice(count, count // 10, replace=False)
    noise[late] += 0.08
    clock = SenderClock(_offsets(begin_s, count, offset_s, ppm, noise))
    stamps = np.linspace(begin_s, begin_s + 5.0 * (count - 1), 50)
    true = stamps + offset_s + ppm * 1e-6 * (stamps - begin_s)
    assert np.abs(clock.to_recorder(stamps, count // 2) - true).max() < 0.5e-3
    assert clock.restarts == 0


def test_two_offsets_say_nothing_of_drift() -> None:
    clock = SenderClock([(100.0, 0.001), (105.0, 0.003)])
    assert clock.to_recorder(np.array([1000.0]))[0] == pytest.approx(1000.002)


@pytest.mark.parametrize("before_offset", [True, False])
def test_a_computer_that_was_started_again_has_a_line_of_its_own(before_offset: bool) -> None:
    none = np.zeros(10)
    first = _offsets(5000.0, 10, 2.0, 0.0, none)
    second = _offsets(20.0, 10, 5100.0, 0.0, none)
    clock = SenderClock([*first, *second])
    assert clock.restarts == 1
    assert clock.to_recorder(np.array([5020.0]), 4)[0] == pytest.approx(5022.0)
    stamps = np.array([18.0 if before_offset else 30.0])
    moved = clock.to_recorder(stamps, 10 if before_offset else 12)
    assert moved[0] == pytest.approx(stamps[0] + 5100.0)


@pytest.mark.parametrize("step_s", [0.06, 0.6, -0.6])
def test_a_clock_that_was_set_by_less_than_a_second_has_two_lines(step_s: float) -> None:
    noise = np.random.default_rng(3).normal(0, 100e-6, 40)
    offsets = _offsets(100.0, 40, 3.0, 20.0, noise)
    offsets[20:] = [(time_s + step_s, offset - step_s) for time_s, offset in offsets[20:]]
    clock = SenderClock(offsets)
    assert clock.restarts == 1
    before, after = (
        clock.to_recorder(np.array([110.0]), 3),
        clock.to_recorder(np.array([290.0]), 39),
    )
    assert before[0] == pytest.approx(113.0, abs=1e-3)
    assert after[0] == pytest.approx(293.0 - step_s, abs=5e-3)
    told = summarise_offsets(offsets)
    assert told.resets == 1
    assert told.scatter_s is not None
    assert told.scatter_s < 1e-3


def test_the_last_offset_of_an_outlet_that_goes_is_no_reset() -> None:
    offsets = _offsets(5000.0, 6, 0.0, 0.0, np.zeros(6))
    told = summarise_offsets([*offsets, (805030.0, -775000.0)])
    assert (told.resets, told.drift_ppm, told.scatter_s) == (0, 0.0, 0.0)


@pytest.mark.parametrize(("step_s", "is_told"), [(0.6, False), (-0.6, False), (600.0, True)])
def test_times_near_a_step_of_the_clock_are_in_doubt_or_right(step_s: float, is_told: bool) -> None:
    true_s = np.arange(1000.0, 1200.0, 5.0)
    stepped = true_s > 1102.0
    offsets = list(
        zip((true_s + step_s * stepped).tolist(), (-step_s * stepped).tolist(), strict=True)
    )
    clock = SenderClock(offsets)
    spans = clock.doubtful_spans
    samples_s = np.arange(1000.0, 1195.0, 0.1)
    stamps = samples_s + step_s * (samples_s > 1102.0)
    found = np.concatenate(
        [
            clock.to_recorder(np.array([stamp]), int(np.searchsorted(true_s, at)))
            for at, stamp in zip(samples_s, stamps, strict=True)
        ]
    )
    wrong = samples_s[np.abs(found - samples_s) > 1e-6]
    assert all(any(each.begin_s <= at <= each.end_s for each in spans) for at in wrong)
    assert np.abs(found - samples_s).max() <= (0.0 if is_told else abs(step_s)) + 1e-6
    assert is_told == (not spans)
    if spans:
        ((begin_s, end_s, found_s),) = [(each.begin_s, each.end_s, each.step_s) for each in spans]
        assert (begin_s, end_s) == (pytest.approx(1100.0), pytest.approx(1105.0))
        assert found_s == pytest.approx(step_s)


def test_samples_without_a_header_are_told_to_whoever_uses_the_others(path: Path) -> None:
    unknown = made.samples(77, "float32", [[0.5]] * 3, [100.0, 100.1, 100.2])
    path.write_bytes(made.xdf(_numbers(1, "a", 100.0, 8), unknown, unknown, made.footer(77, 3)))
    with open_contents(path) as contents:
        (damage,) = contents.damages
        assert damage.what == "the samples of stream number 77 have no header"
        assert [each.sample_count for each in contents.streams] == [8]
    # A header that cannot be read is damage by itself.
    broken = made.chunk(2, (77).to_bytes(4, "little") + b"<info>")
    path.write_bytes(made.xdf(_numbers(1, "a", 100.0, 8), broken, unknown))
    with open_contents(path) as contents:
        (damage,) = contents.damages
        assert "header" in damage.what
