"""What is read of a file that grows, byte by byte as it may come."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path

import pytest

from biosensor_common.naming import source_id
from biosensor_gateway.agent.device_states import clock_time
from biosensor_gateway.recording.recorder.live_file import GrowingFile, Growth
from biosensor_gateway.recording.xdf.container import Tag
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.verdict import check
from biosensor_gateway.streaming.counters import Counters, counters_text
from tests.recording_export.study import ours
from tests.xdf.own_streams import own_header
from tests.xdf.test_judging import event
from tests.xdf.test_participants import AGENT, heartbeat, strap
from tests.xdf.xdf_file import FILE_HEADER, boundary, chunk, footer, samples, stream_header, xdf

HEAD = b"XDF:" + chunk(1, FILE_HEADER) + stream_header(1, "one", rate=10.0)
TWO = stream_header(2, "two", rate=10.0)
MARKERS = stream_header(3, "marks")
UNIX_S = 1_700_000_000.0


def data(stream: int, *stamps: float) -> bytes:
    return samples(stream, "float32", [[1.0]] * len(stamps), stamps)


def offset(stream: int, time: float, value: float = 0.0) -> bytes:
    return chunk(4, struct.pack("<Idd", stream, time, value))


class Written:
    """A file that is written piece by piece, and watched."""

    def __init__(self, path: Path) -> None:
        self.now = 0.0
        self._file = path / "a.xdf"
        self.growth = Growth(self._file, lambda: self.now)

    def write(self, content: bytes) -> None:
        with self._file.open("ab") as file:
            file.write(content)
        self.growth.look()

    def codes(self, *required: str, silent: tuple[str, ...] = ()) -> list[tuple[str, str]]:
        return [(each.stream, each.code) for each in self.growth.problems(required, silent)]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    return Written(tmp_path)


def test_a_file_that_is_moved_away_or_shortened_is_said_at_once(
    written: Written, tmp_path: Path
) -> None:
    file = tmp_path / "a.xdf"
    written.write(HEAD + data(1, 101.0, 101.1))
    assert written.codes() == []
    moved = file.rename(tmp_path / "b.xdf")
    written.growth.look()
    (found,) = written.growth.problems()
    assert (found.code, found.level) == ("file-gone", Level.ERROR)
    assert "it was moved, renamed or deleted" in found.text
    moved.rename(file)
    written.growth.look()
    assert written.codes() == []
    file.write_bytes(HEAD)
    written.growth.look()
    (found,) = written.growth.problems()
    assert "was shortened or replaced by another program" in found.text


@pytest.mark.parametrize("step", [1, 7, 1000])
def test_any_cutting_gives_the_same_and_no_damage(tmp_path: Path, step: int) -> None:
    content = HEAD + TWO + data(1, 101.0, 101.1) + boundary() + offset(1, 102.0) + data(2, 102.5)
    path = tmp_path / "a.xdf"
    tags: list[Tag] = []
    growing = GrowingFile(path, lambda tag, _: tags.append(tag))
    growth = Growth(path)
    with path.open("wb") as file:
        for at in range(0, len(content), step):
            file.write(content[at : at + step])
            file.flush()
            growing.read_on()
            sight = growth.look()
            assert sight.damages == ()
    assert tags == [Tag.FILE_HEADER, Tag.STREAM_HEADER, Tag.STREAM_HEADER, Tag.SAMPLES,
                    Tag.BOUNDARY, Tag.CLOCK_OFFSET, Tag.SAMPLES]  # fmt: skip
    sight = growth.look()
    first, second = sight.streams
    assert (first.samples, first.newest_stamp, first.clock_offsets) == (2, 101.1, 1)
    assert first.age_s == pytest.approx(1.4)
    assert first.offset_age_s == pytest.approx(0.5)
    assert (second.samples, second.age_s, second.clock_offsets) == (1, 0.0, 0)
    assert sight.bytes == len(content)


def test_nothing_is_read_twice(tmp_path: Path) -> None:
    path = tmp_path / "a.xdf"
    path.write_bytes(HEAD + data(1, 101.0))
    growth = Growth(path)
    growth.look()
    # What was read is no longer needed.
    path.write_bytes(b"\0" * path.stat().st_size + data(1, 101.1))
    sight = growth.look()
    assert (sight.streams[0].samples, sight.damages) == (2, ())


def test_who_stops_while_others_go_on_is_named(written: Written) -> None:
    written.write(HEAD + TWO + MARKERS + data(1, 101.0) + data(2, 101.0) + data(3, 101.0))
    written.write(data(1, 105.9))
    assert written.codes() == []
    written.write(data(1, 106.2))
    # Markers are silent by design.
    assert written.codes() == [("two", "stopped")]
    assert written.codes(silent=("two-id",)) == []
    written.write(data(2, 106.3))
    assert written.codes() == []


def test_a_stream_that_has_not_begun_is_named_until_it_has(written: Written) -> None:
    written.write(HEAD + TWO + MARKERS)
    assert written.codes() == [("", "not-begun")]
    written.write(data(1, 101.0) + data(1, 104.0))
    (found,) = written.growth.problems()
    assert (found.level, found.text) == (Level.WARNING, "nothing recorded yet from two")
    assert written.codes(silent=("two-id",)) == []
    written.write(data(1, 106.5))
    assert written.codes() == [("two", "stopped")]
    written.write(data(2, 106.5))
    assert written.codes() == []


def test_a_slow_stream_has_time_for_some_samples(written: Written) -> None:
    written.write(HEAD + stream_header(2, "slow", rate=0.1))
    written.write(data(1, 101.0) + data(2, 101.0) + offset(1, 106.0) + data(1, 130.0))
    assert written.codes() == [("slow", "no-offsets"), ("one", "no-offsets")]
    assert [each.level for each in written.growth.problems()] == [Level.ERROR, Level.WARNING]
    written.write(offset(1, 131.5) + offset(2, 131.5) + data(1, 131.5))
    assert written.codes() == [("slow", "stopped")]


def test_whose_program_gives_no_answer_is_named_although_its_clock_offset_is_repeated(
    written: Written,
) -> None:
    written.write(HEAD + MARKERS + data(1, 100.0))
    for k in range(10):
        # The program of the markers ends after 10 s.
        answer = offset(3, 101.0 + 5 * k, 1.2345678e-5 + min(k, 2) * 1e-8)
        written.write(offset(1, 101.0 + 5 * k, k * 1.1e-8) + answer)
        written.write(data(1, *(101.0 + 5 * k + n for n in range(6))))
        is_long = 5 * (k - 2) + 5 > 20
        assert written.codes() == [("marks", "no-offsets")] * is_long, k
    (found,) = written.growth.problems()
    assert found.level is Level.WARNING
    assert found.text.startswith("its clock has not been measured for 40 s: the program has ended")
    written.write(offset(3, 151.0, 1.25e-5))
    assert written.codes() == []


def test_what_had_waited_in_a_device_is_no_beginning(written: Written) -> None:
    written.write(HEAD + TWO + data(1, 101.0) + data(2, 220.0))
    assert written.codes() == []
    assert written.growth.look().length_s == 0.0


def test_who_never_begins_is_named(written: Written) -> None:
    written.write(HEAD + TWO + data(1, 101.0) + data(1, 107.0))
    assert written.codes() == [("", "not-begun")]
    written.write(offset(1, 107.0) + data(1, 113.0))
    assert written.codes("one-id", "two-id", "x-id") == [("x-id", "missing"), ("two", "stopped")]


def test_missing_is_not_said_before_all_headers_are_there(written: Written) -> None:
    written.write(HEAD)
    assert written.codes("two-id") == [("", "not-begun")]
    written.write(TWO + data(1, 101.0))
    assert written.codes("two-id") == [("", "not-begun")]


@pytest.mark.parametrize("error_s", [1.8e9, 500.0, -500.0])
def test_stamps_of_a_wrong_clock_mislead_only_until_it_was_measured(
    written: Written, error_s: float
) -> None:
    written.write(HEAD + TWO + data(1, 1001.0) + data(2, 1001.0 + error_s))
    written.write(offset(1, 1006.0) + offset(2, 1006.0))
    written.write(data(1, 1007.0) + data(2, 1007.0 + error_s))
    written.write(data(1, 1009.0) + data(2, 1009.0 + error_s))
    assert written.codes() == []
    written.write(data(1, 1015.0))
    assert written.codes() == [("two", "stopped")]


def test_clocks_of_other_computers_are_brought_together(written: Written) -> None:
    written.write(HEAD + TWO + offset(1, 101.0) + offset(2, 5001.0, -4900.0))
    written.write(data(1, 102.0) + data(2, 5002.5, 5003.0))
    written.write(data(1, 104.0))
    second = written.growth.look().streams[1]
    assert second.age_s == pytest.approx(1.0)


def test_an_offset_of_an_outlet_that_has_gone_is_none(written: Written) -> None:
    written.write(HEAD + TWO + data(1, 1001.0) + data(2, 1001.0) + offset(1, 0.0))
    first, _ = written.growth.look().streams
    assert (first.clock_offsets, first.age_s) == (0, 0.0)
    written.write(data(1, 1002.0))
    assert written.growth.look().streams[0].age_s == 0.0
    assert written.growth.look().streams[1].age_s == pytest.approx(1.0)


def test_damage_is_said_once_and_read_on_behind_it(written: Written) -> None:
    written.write(HEAD + data(1, 101.0) + b"\7\7\7 garbage")
    written.write(b"more garbage" + boundary()[:9])
    assert written.codes() == [("", "damaged")]
    written.write(boundary()[9:] + data(1, 102.0))
    assert written.codes() == [("", "damaged")]
    assert written.growth.look().streams[0].samples == 2


def test_a_file_that_rests_is_said(written: Written) -> None:
    written.write(HEAD + data(1, *[101.0 + at / 10 for at in range(100)]))
    written.write(offset(1, 111.0) + data(1, 111.0) * 10_000)
    written.now = 10.0
    assert written.codes() == []
    written.now = 16.0
    assert written.codes() == [("", "still")]
    written.write(footer(1, 1))
    assert written.codes() == []
    assert written.growth.look().is_closed


@pytest.mark.parametrize(
    ("began_s_ago", "written_s_ago", "codes"),
    [
        (60.0, 40.0, ["still"]),
        # What a recorder keeps before it writes.
        (60.0, 10.0, []),
        # The clock of a file server is behind, or the program took long to begin.
        (12.0, 40.0, []),
        # The clock was set back by 60 s since.
        (60.0, -60.0, ["still"]),
    ],
)
def test_that_a_file_rests_is_said_at_the_first_look_too(
    tmp_path: Path, began_s_ago: float, written_s_ago: float, codes: list[str]
) -> None:
    file, now = tmp_path / "a.xdf", 1.8e9
    ten_seconds = data(1, *[101.0 + at / 10 for at in range(100)])
    file.write_bytes(HEAD + ten_seconds + offset(1, 111.0) + data(1, 111.0) * 10_000)
    os.utime(file, (now - written_s_ago, now - written_s_ago))
    growth = Growth(file, lambda: 0.0, now - began_s_ago, lambda: now)
    growth.look()
    assert [each.code for each in growth.problems() if each.code != "missing"] == codes
    # It is watched from now on.
    with file.open("ab") as more:
        more.write(offset(1, 112.0))
    growth.look()
    assert "still" not in [each.code for each in growth.problems()]


def test_a_file_that_is_not_there_is_empty_and_gone(written: Written) -> None:
    sight = written.growth.look()
    assert (sight.bytes, sight.streams) == (0, ())
    assert written.codes("one-id") == [("", "file-gone")]


def _steady(begin: float, count: int) -> list[float]:
    return [begin + number / 10 for number in range(count)]


def test_gaps_stay_said_when_all_goes_on(written: Written) -> None:
    written.write(HEAD + TWO + data(1, *_steady(101.0, 120)) + data(2, 101.0, 101.1, 101.2))
    assert list(written.growth.gaps()) == []
    # Between two chunks, and within one.
    written.write(data(1, *_steady(115.8, 60), *_steady(122.7, 60)))
    (gap,) = written.growth.gaps()
    assert (gap.stream, gap.text) == ("one", "2 gaps so far, the longest of 2.9 s")
    assert "gaps" not in {code for _, code in written.codes()}


STRAPS = (strap("P01"), strap("P02", "A2"))


def _told(*events: dict[str, object]) -> bytes:
    return samples(9, "string", [[json.dumps(each)] for each in events], _seconds(len(events)))


def _seconds(count: int) -> list[float]:
    return [1001.0 + number for number in range(count)]


def _beat(at: float, started: float = 900.0, session: str = "") -> dict[str, object]:
    clock = {"lsl_s": at, "unix_ns": round((UNIX_S + at) * 1e9)}
    told = heartbeat(polar_h10__A1="streaming", polar_h10__A2="streaming")
    return told | {"agent_started": started, "lsl_time": at, "clock": clock, "session": session}


def _later(at: float, by_s: float, started: float = 900.0) -> dict[str, object]:
    clock = {"lsl_s": at, "unix_ns": round((UNIX_S + at + by_s) * 1e9)}
    return {**_beat(at, started), "clock": clock}


def events_with_steps(*beats: tuple[float, float]) -> bytes:
    """Return an agent's events: times on LSL's clock, and by how much the time of day is ahead."""
    return own_header(9, AGENT, "events") + _told(*(_later(*each) for each in beats))


def test_a_clock_that_is_set_and_a_sleep_are_said(written: Written) -> None:
    written.write(_recording(_told(_beat(1001.0), _later(1006.0, 0.004), _later(1011.0, 20.0))))
    (found,) = written.growth.clock_set()
    assert (found.level, found.code) == (Level.WARNING, "clock-set")
    assert "it slept for 20.0 s, or its clock was set forward by that" in found.text
    # Another start of the agent, maybe after one of the computer.
    written.write(_told(_later(1016.0, -50.0), _later(1021.0, 0.0, 1017.0)))
    texts = [each.text for each in written.growth.clock_set()]
    assert len(texts) == 2 and "its clock was set back by 70.0 s" in texts[1]


def _acc(stream: int, *runs: tuple[float, float]) -> bytes:
    stamps = [begin + k / 50 for begin, end in runs for k in range(round((end - begin) * 50))]
    return samples(stream, "float32", [[0.0, 0.0, 1.0]] * len(stamps), stamps)


def test_a_verdict_says_each_step_of_a_clock_once(tmp_path: Path) -> None:
    file = tmp_path / "a.xdf"
    file.write_bytes(HEAD + data(1, 1001.0) + events_with_steps((1001.0, 0.0), (1006.0, 20.0)))
    told = [(by_s, Finding(Level.WARNING, "clock-set", "", f"{by_s}")) for by_s in (20.0, 31.0)]
    found = [each.text for each in check(file, clock_set=told).findings if each.code == "clock-set"]
    assert len(found) == 2
    assert "it slept for 20.0 s" in found[0] and found[1] == "31.0"


def _recording(*content: bytes) -> bytes:
    headers = [own_header(number, each, "acc") for number, each in enumerate(STRAPS, 1)]
    return xdf(*headers, own_header(9, AGENT, "events"), *content)


def test_what_the_agent_refuses_or_doubts_is_told_while_it_is_recorded(written: Written) -> None:
    flat, late = "P01-ecg: ECG (0 microvolts) has not changed", "P01-hr: 2 samples came late"
    problems = {
        "polar_h10/A1": [{"what": flat}, {"what": late, "last": 999.0}],
        "zephyr/other": [{"what": flat}],
    }
    written.write(_recording(_told(_beat(1000.5) | {"problems": problems}), _acc(1, (1000, 1005))))
    (found,) = written.growth.refused()
    assert (found.level, found.code) == (Level.WARNING, "refused")
    assert found.text == f"polar_h10/A1 of P01: {flat}"
    # It stays when it is over, for the analysis has to know it.
    written.write(_told(_beat(1004.0)))
    assert list(written.growth.refused()) == [found]


def test_what_the_agent_refuses_of_a_stream_is_told_while_it_is_recorded(written: Written) -> None:
    before, lasting, new = "3 samples were refused: before", "it stands still", "1 sample came late"
    written.write(xdf(own_header(1, STRAPS[0], "acc"), own_header(8, AGENT, "counters")))
    source = source_id(STRAPS[0], "acc")

    def tell(second: int, *refused: str) -> list[str]:
        count = Counters(pushed=50 * second, last_stamp=1000.0 + second)
        text = counters_text({source: count}, refused={source: refused})
        written.write(samples(8, "string", [[text]], [1000.0 + second]))
        found = list(written.growth.refused())
        assert {(e.level, e.stream) for e in found} <= {(Level.WARNING, "P01-polar_h10-A1-acc")}
        return [each.text for each in found]

    assert tell(1, before) == []
    assert tell(2, before, lasting) == [lasting]
    assert tell(3, before, lasting, new) == [lasting, new]
    # Of each kind the newest; what is over stays, for the analysis has to know it.
    assert tell(4, new.replace("1", "2")) == [lasting, new.replace("1", "2")]
    assert [before in tell(second, before) for second in range(5, 14)] == [False] * 7 + [True] * 2


def test_losses_that_leave_no_gap_are_told_while_it_is_recorded(written: Written) -> None:
    written.write(xdf(own_header(1, STRAPS[0], "ibi"), own_header(8, AGENT, "counters")))
    told: list[list[str]] = []
    # The third is of an agent that was restarted.
    for second, lost in enumerate([7, 9, 0, 1], 1):
        count = Counters(pushed=second, lost=lost, last_stamp=1000.0 + second)
        text = counters_text({source_id(STRAPS[0], "ibi"): count})
        written.write(samples(8, "string", [[text]], [1000.0 + second]))
        told.append([each.text for each in written.growth.lost()])
    two, three = (
        [f"the agent has counted {count} samples as lost on the way from the device"]
        for count in (2, 3)
    )
    assert told == [[], two, two, three]


def test_a_sensor_that_a_restarted_agent_has_no_longer_is_red(written: Written) -> None:
    written.write(_recording(_told(_beat(1000.5)), _acc(1, (1000, 1005)), _acc(2, (1000, 1005))))
    assert list(written.growth.gone()) == []
    written.write(_told(_beat(1004.0) | {"devices": {"polar_h10/A1": "streaming"}}))
    (found,) = written.growth.gone()
    assert found.level is Level.ERROR
    assert found.text.startswith("polar_h10/A2 (P02) has not been among the agent's sensors")
    written.write(_told(_beat(1005.0)))
    assert list(written.growth.gone()) == []


def test_a_pause_is_told_as_a_pause_while_it_is_recorded(written: Written) -> None:
    written.write(_recording(_told(_beat(1000.5)), _acc(1, (1000, 1005)), _acc(2, (1000, 1005))))
    written.write(_told(event("paused", 1005.0)) + _acc(2, (1005, 1007), (1007.5, 1009)))
    written.write(_acc(1, (1009, 1012)) + _acc(2, (1009, 1012)))
    # Its end stands in the file a moment after what was sent behind it.
    (gap,) = written.growth.gaps()
    assert (gap.stream, gap.text) == ("P02-polar_h10-A2", "1 gap so far, of 0.52 s")
    assert list(written.growth.was_away()) == []
    written.write(_told(event("resumed", 1008.0)))
    (gap,) = written.growth.gaps()
    assert gap.stream == "P02-polar_h10-A2"
    (over,) = written.growth.was_away()
    since, until = (clock_time(UNIX_S + at, seconds=True) for at in (1005, 1008))
    assert (over.level, over.text) == (
        Level.WARNING,
        f"P01's Polar H10 was paused from {since} until {until}",
    )


def test_a_gap_while_a_device_was_away_is_one_event_with_it(written: Written) -> None:
    events = _told(_beat(1000.5), event("disconnected", 1005.0), event("connected", 1008.0))
    written.write(_recording(events, _acc(1, (1000, 1005), (1008.5, 1012))))
    (gap,), (away,) = written.growth.gaps(), written.growth.was_away()
    assert (gap.text, gap.part_of) == ("1 gap so far, of 3.52 s", away.text)
    # Another one is none of it.
    written.write(_acc(1, (1013, 1014)))
    (gap,) = written.growth.gaps()
    assert (gap.text, gap.part_of) == ("2 gaps so far, the longest of 3.52 s", "")


def test_a_gap_beside_a_pause_is_counted_all_the_same(written: Written) -> None:
    events = _told(_beat(1000.5), event("paused", 1005.0), event("resumed", 1008.0))
    written.write(_recording(events, _acc(1, (1000, 1002), (1002.5, 1005), (1009, 1012))))
    (gap,) = written.growth.gaps()
    assert gap.text == "1 gap so far, of 0.52 s"


@pytest.mark.parametrize(
    ("second", "own_started", "is_other"),
    [
        # It ran beside the first one.
        (_beat(1009.0, 950.0), None, True),
        # One's own was started again, and is what is recorded now.
        (_beat(1009.0, 1007.5), 1007.5, False),
        (_beat(1009.0, 1007.5), None, False),
        # One's own was started again, and is not what is recorded.
        (_beat(1009.0, 1007.5), 1008.2, True),
        (_beat(1009.0, 1007.5, "room-2"), None, True),
        # It runs since before the recording, and its last sign of life is older than its start.
        (_beat(1009.0), 1010.0, False),
    ],
)
def test_another_agent_is_told_while_it_is_recorded(
    written: Written, second: dict[str, object], own_started: float | None, is_other: bool
) -> None:
    first = [_beat(1001.0, session="room-1"), _beat(1006.0, session="room-1")]
    second["session"] = second["session"] or "room-1"
    written.write(_recording(_acc(1, (1000, 1010)), _told(*first, second)))
    events = source_id(AGENT, "events")
    found = list(written.growth.other_agents(events, own_started))
    assert [(each.level, each.code) for each in found] == [
        (Level.ERROR, "another-agent")
    ] * is_other
    if is_other:
        at = clock_time(UNIX_S + 1009.0, seconds=True)
        assert found[0].text.startswith(f"from {at} on it belongs to another agent")
    # Of another computer's agent it is not known when it began.
    assert not list(written.growth.other_agents("elsewhere", 1008.2)) or own_started != 1008.2


@pytest.mark.parametrize(("off_s", "is_other"), [(0.0, False), (0.007, True), (-0.007, True)])
@pytest.mark.parametrize("is_late", [False, True])
def test_a_single_stream_of_another_agent_is_told_while_it_is_recorded(
    written: Written, off_s: float, is_other: bool, is_late: bool
) -> None:
    """Those of events and counters are of one's own; what they tell may stand before or behind."""
    headers = [own_header(1, STRAPS[0], "acc"), own_header(8, AGENT, "counters")]
    written.write(xdf(*headers))
    told: list[bytes] = []
    for second in range(20):
        begin = 1000.0 + second
        # One gap, in which nothing comes, is a loss and no other stream.
        is_lost = 3 <= second < 5
        begin_here = begin + (off_s if second >= 8 else 0.0)
        count = Counters(pushed=50 * (second + 1), last_stamp=begin + 49 / 50)
        text = counters_text({source_id(STRAPS[0], "acc"): count})
        told.append(samples(8, "string", [[text]], [begin + 1]))
        came = [] if is_lost else [_acc(1, (begin_here, begin_here + 1))]
        written.write(b"".join([*came, told[-1]] if not is_late else [*told[-2:-1], *came]))
    found = list(written.growth.other_agents("", None))
    assert [(each.code, each.stream) for each in found] == [
        ("another-agent", "P01-polar_h10-A1-acc")
    ] * is_other


@pytest.mark.parametrize(
    ("participants", "level"),
    [(("P01", "P02"), Level.WARNING), (("P02",), Level.ERROR), (("P01", ""), None)],
)
def test_a_file_called_after_somebody_else_is_not_green_while_it_grows(
    tmp_path: Path, participants: tuple[str, ...], level: Level | None
) -> None:
    path = tmp_path / "sub-P01_task-walk_beh.xdf"
    streams = [
        ours(number, "polar_h10", "hr", [[64.0]], [101.0], participant)
        for number, participant in enumerate(participants, 1)
    ]
    path.write_bytes(xdf(*streams))
    growth = Growth(path)
    growth.look()
    found = [each.level for each in growth.problems() if each.code == "other-participants"]
    assert found == ([] if level is None else [level])
