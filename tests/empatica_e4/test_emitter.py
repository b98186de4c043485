"""What each line of the E4 server puts into which stream, and what the radio lost."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common.refusal import Refusal
from biosensor_gateway.devices.empatica_e4 import SPEC
from biosensor_gateway.devices.empatica_e4.driver.emitter import (
    BRIDGED_S,
    WINDOW_S,
    E4Emitter,
    LossEstimate,
)
from biosensor_gateway.devices.empatica_e4.driver.protocol import (
    MAX_LINE_BYTES,
    E4Protocol,
    Event,
    Flaw,
    Malformed,
    Message,
    Reply,
    Sample,
    Stream,
    request,
)
from tests.rigs.emitter_sink import EmitterSink

# What each line of the E4 server puts into which stream, and what it does not.

UNIX_S = 1_680_442_024.0
ARRIVAL_S = 5_000.0
NAN = math.nan


class LinkedEmitter:
    """An emitter that has been told of a new radio link, and its sink."""

    def __init__(self) -> None:
        self.sink = EmitterSink("empatica_e4")
        self.emitter = E4Emitter(self.sink)
        self.emitter.new_epoch()

    def take(self, stream: Stream, after_s: float, *values: float, late_s: float = 0.0) -> None:
        sample = Sample(stream, UNIX_S + after_s, values)
        self.emitter.take([sample], ARRIVAL_S + after_s + late_s)

    def stream_bvp(self, begin_s: float, end_s: float, *, ahead_s: float = 0.0) -> None:
        """Take BVP; the stamps may run behind what the arrival says by a loss."""
        for number in range(round(begin_s * 64), round(end_s * 64)):
            sample = Sample(Stream.BVP, UNIX_S + number / 64 - ahead_s, (float(number),))
            self.emitter.take([sample], ARRIVAL_S + number / 64)


@pytest.fixture
def bench() -> LinkedEmitter:
    return LinkedEmitter()


def test_values_are_those_of_the_declaration(bench: LinkedEmitter) -> None:
    bench.take(Stream.BVP, 0.0, -12.5)
    bench.take(Stream.ACC, 0.03, -64.0, 0.0, 127.0)
    bench.take(Stream.TMP, 0.0, 33.75)
    bench.take(Stream.GSR, 0.0, 0.0832364)
    bench.take(Stream.BAT, 0.0, 0.73)
    bench.take(Stream.HR, 0.0, 72.5)
    bench.take(Stream.IBI, 0.0, 0.828125)
    emitted = bench.sink.emitted
    assert emitted["bvp"] == [[-12.5]]
    assert emitted["acc"] == [[-1.0, 0.0, 127 / 64]]
    assert emitted["st"] == [[33.75]]
    assert emitted["gsr"] == [[0.0832364]]
    assert emitted["bat"] == [[pytest.approx(73.0)]]
    assert emitted["hr"] == [[72.5]]
    assert emitted["ibi"] == [[0.828125]]
    assert set(emitted) == {stream.data_name for stream in SPEC.streams} - {"tag"}


def test_a_press_of_the_button_is_a_marker(bench: LinkedEmitter) -> None:
    bench.take(Stream.BVP, 0.0, 1.0)
    bench.take(Stream.TAG, 0.5)
    assert bench.sink.texts == [("tag", "button", UNIX_S + 0.5)]


def test_only_what_is_not_late_by_design_moves_the_clock(bench: LinkedEmitter) -> None:
    bench.take(Stream.BVP, 1.0, 1.0)
    bench.take(Stream.ACC, 1.01, 1.0, 2.0, 3.0)
    for stream in (Stream.GSR, Stream.TMP, Stream.IBI, Stream.HR, Stream.BAT):
        bench.take(stream, 0.5, 1.0, late_s=5.6)
    bench.take(Stream.TAG, 0.7)
    assert bench.sink.observed == [
        (UNIX_S + 1.0, ARRIVAL_S + 1.0),
        (UNIX_S + 1.01, ARRIVAL_S + 1.01),
    ]


def test_of_samples_that_arrive_together_the_newest_moves_the_clock(bench: LinkedEmitter) -> None:
    samples = [Sample(Stream.BVP, UNIX_S + k / 64, (1.0,)) for k in range(64)]
    bench.emitter.take(samples, ARRIVAL_S + 1)
    assert bench.sink.observed == [(samples[-1].time_s, ARRIVAL_S + 1)]
    assert bench.sink.times["bvp"] == [sample.time_s for sample in samples]


def test_what_cannot_be_mapped_yet_waits_for_what_can(bench: LinkedEmitter) -> None:
    bench.take(Stream.GSR, 0.0, 1.0)
    bench.take(Stream.GSR, 0.25, 2.0)
    bench.take(Stream.TAG, 0.3)
    assert bench.sink.emitted == {}
    bench.take(Stream.BVP, 0.35, 1.0)
    assert bench.sink.emitted["gsr"] == [[1.0], [2.0]]
    assert len(bench.sink.texts) == 1
    bench.emitter.new_epoch()
    bench.take(Stream.GSR, 0.5, 3.0)
    assert len(bench.sink.emitted["gsr"]) == 2
    bench.take(Stream.ACC, 0.6, 1.0, 1.0, 1.0)
    assert bench.sink.emitted["gsr"] == [[1.0], [2.0], [3.0]]


def test_a_line_that_comes_twice_is_one_sample(bench: LinkedEmitter) -> None:
    for after_s in (0.0, 0.0, 1 / 64, 1 / 64, 2 / 64):
        bench.take(Stream.BVP, after_s, 7.0)
    assert bench.sink.times["bvp"] == [UNIX_S + k / 64 for k in range(3)]
    assert bench.sink.refusals.count(Refusal.LEFT_OUT) == 2
    # A stamp that two streams share is no repetition.
    bench.take(Stream.HR, 1.0, 60.0)
    bench.take(Stream.IBI, 1.0, 1.0)
    assert (len(bench.sink.emitted["hr"]), len(bench.sink.emitted["ibi"])) == (1, 1)


def conduct(bench: LinkedEmitter, values: Sequence[float], begin_s: float = 0.0) -> None:
    for number, value in enumerate(values):
        bench.take(Stream.GSR, begin_s + number / 4, value)


def test_no_conductance_keeps_its_place_and_for_two_seconds_means_not_worn(
    bench: LinkedEmitter,
) -> None:
    bench.take(Stream.BVP, 0.0, 1.0)
    conduct(bench, [1.0] + [0.0] * 7 + [2.0])
    assert [row[0] for row in bench.sink.emitted["quality"]] == [1.0]
    conduct(bench, [0.0] * 12, 3.0)
    conduct(bench, [2.0, 2.0], 6.0)
    assert [row[0] for row in bench.sink.emitted["quality"]] == [1.0, 0.0, 1.0]
    assert bench.sink.times["quality"] == [UNIX_S, UNIX_S + 4.75, UNIX_S + 6.0]
    gsr = np.array(bench.sink.emitted["gsr"])[:, 0]
    assert np.isnan(gsr).tolist() == [False] + [True] * 7 + [False] + [True] * 12 + [False] * 2


def test_at_the_start_a_few_open_samples_do_not_tell(bench: LinkedEmitter) -> None:
    bench.take(Stream.BVP, 0.0, 1.0)
    conduct(bench, [0.0] * 7)
    assert "quality" not in bench.sink.emitted
    conduct(bench, [0.0], 2.0)
    assert [row[0] for row in bench.sink.emitted["quality"]] == [0.0]


def test_without_loss_quality_says_so_every_window(bench: LinkedEmitter) -> None:
    bench.stream_bvp(0, 3 * WINDOW_S + 1)
    np.testing.assert_equal(bench.sink.emitted["quality"], [[NAN, 0.0]] * 3)
    assert set(bench.sink.losses.values()) <= {0}
    assert bench.sink.restarts == [0]


def test_radio_loss_is_counted_for_every_stream_and_starts_the_clock_again(
    bench: LinkedEmitter,
) -> None:
    bench.stream_bvp(0, 15)
    with capture_logs() as logs:
        bench.stream_bvp(17, 45, ahead_s=2.0)
    lost = bench.sink.losses
    assert lost["bvp"] == pytest.approx(128, abs=4)
    assert lost["acc"] == pytest.approx(64, abs=2)
    assert lost["gsr"] == lost["st"] == 8
    assert len(bench.sink.restarts) == 2
    losses = [row[1] for row in bench.sink.emitted["quality"]]
    assert [loss for loss in losses if loss] == [pytest.approx(0.2, abs=0.01)]
    (entry,) = [entry for entry in logs if "estimated" in entry["event"]]
    assert entry["seconds"] == pytest.approx(2.0, abs=0.05)
    # Those that came after are where they were measured.
    newest = bench.sink.times["bvp"][-1]
    assert bench.sink.mapped(newest) == pytest.approx(newest - UNIX_S + 2.0 + ARRIVAL_S, abs=0.02)


def test_a_gap_that_was_told_is_counted_without_another_start_of_the_clock(
    bench: LinkedEmitter,
) -> None:
    bench.stream_bvp(0, 25)
    bench.emitter.new_epoch()
    bench.stream_bvp(30, 55)
    assert bench.sink.losses["bvp"] == pytest.approx(5 * 64, abs=4)
    assert len(bench.sink.restarts) == 2
    # What is lost later is another matter.
    bench.stream_bvp(58, 85, ahead_s=3.0)
    assert bench.sink.losses["bvp"] == pytest.approx(8 * 64, abs=6)
    assert len(bench.sink.restarts) == 3


def test_a_wristband_that_was_switched_off_lost_nothing(bench: LinkedEmitter) -> None:
    bench.stream_bvp(0, 25)
    bench.emitter.switched_off()
    bench.emitter.new_epoch()
    bench.stream_bvp(45, 70)
    assert set(bench.sink.losses.values()) <= {0}


# The estimate of what the radio lost: from numbers of samples and their arrival alone.
RATE_HZ = 64.0
HOUR_S = 3600.0


def arrivals(
    seconds: float, *, drift_ppm: float = 0.0, jitter_s: float = 0.0, seed: int = 0
) -> np.ndarray:
    """When samples of a wristband arrive; positive drift is a slow oscillator."""
    count = int(seconds * RATE_HZ)
    measured = np.arange(count) / RATE_HZ * (1 + drift_ppm * 1e-6)
    delays = np.random.default_rng(seed).uniform(0, jitter_s, count)
    return np.maximum.accumulate(measured + delays)


def estimates(times: Iterable[float], estimate: LossEstimate | None = None) -> Iterator[float]:
    estimate = estimate or LossEstimate(RATE_HZ)
    for time in times:
        lost_s = estimate.take(1, float(time))
        if lost_s is not None:
            yield lost_s


@pytest.mark.parametrize("drift_ppm", [-200, 47, 200, 400])
def test_drift_of_the_oscillator_is_no_loss_however_long(drift_ppm: float) -> None:
    told = list(estimates(arrivals(HOUR_S, drift_ppm=drift_ppm, jitter_s=0.05)))
    assert len(told) == pytest.approx(HOUR_S / WINDOW_S, abs=2)
    assert set(told) == {0.0}


@settings(max_examples=30)
@given(
    share=st.floats(0.01, 0.9),
    drift_ppm=st.floats(-200, 200),
    jitter_s=st.floats(0, 0.1),
    seed=st.integers(0, 99),
)
def test_a_share_of_lost_samples_is_found(
    share: float, drift_ppm: float, jitter_s: float, seed: int
) -> None:
    times = arrivals(120, drift_ppm=drift_ppm, jitter_s=jitter_s, seed=seed)
    kept = times[np.random.default_rng(seed).random(len(times)) >= share]
    told = sum(estimates(kept))
    # Of steady loss, the two newest windows are not told yet; drift may hide a little.
    told_until_s = 120 - 2 * WINDOW_S
    assert told_until_s * share * 0.85 - 0.5 < told < 120 * share * 1.1 + 0.3


@settings(max_examples=30)
@given(st.floats(0.2, 8.0), st.floats(11.0, 30.0))
def test_a_hole_is_told_once_and_whole(hole_s: float, begin_s: float) -> None:
    times = arrivals(80, jitter_s=0.03)
    kept = times[(times < begin_s) | (times >= begin_s + hole_s)]
    told = [lost_s for lost_s in estimates(kept) if lost_s]
    assert len(told) == 1
    assert told[0] == pytest.approx(hole_s, abs=0.06)


def test_a_known_gap_is_told_at_the_end_of_its_own_window() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(60)
    before = list(estimates(times[times < 25], estimate))
    estimate.begin_window()
    after = list(estimates(times[times >= 30], estimate))
    assert set(before) == {0.0}
    assert after[0] == pytest.approx(5.0, abs=0.05)
    assert set(after[1:]) == {0.0}


def test_a_first_sample_that_came_late_hides_no_gap() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(30)
    times[0] = times[20]
    assert list(estimates(times[times < 5], estimate)) == []
    estimate.begin_window()
    told = list(estimates(np.sort(times[times >= 6]), estimate))
    assert told[0] == pytest.approx(1.0, abs=0.05)


def test_a_backlog_is_no_loss() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(60)
    # A server that is held up for 4 s sends everything after it.
    late = np.where((times > 22) & (times < 26), 26.0, times)
    assert set(estimates(late, estimate)) == {0.0}


def test_what_came_before_a_long_silence_says_nothing() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(200 + BRIDGED_S)
    kept = times[(times < 30) | (times > 31 + BRIDGED_S)]
    assert set(estimates(kept, estimate)) == {0.0}


def test_being_switched_off_is_no_loss() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(100)
    assert set(estimates(times[times < 30], estimate)) == {0.0}
    estimate.forget()
    assert set(estimates(times[times > 50], estimate)) == {0.0}


@given(st.lists(st.integers(1, 40), min_size=5, max_size=30))
def test_it_does_not_matter_how_samples_are_read_together(sizes: list[int]) -> None:
    times = arrivals(45)
    one, many = LossEstimate(RATE_HZ), LossEstimate(RATE_HZ)
    ends = np.cumsum(sizes)
    ends = [*ends[ends < len(times)].tolist(), len(times)]
    for begin, end in zip([0, *ends], ends, strict=False):
        arrival = float(times[end - 1])
        for _ in range(begin, end - 1):
            assert one.take(1, arrival) in (None, 0.0)
        assert one.take(1, arrival) in (None, 0.0)
        assert many.take(end - begin, arrival) in (None, 0.0)


# The E4 text protocol: every vector, and any bytes in any pieces.

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/empatica_e4.json").read_text(encoding="utf-8")
)["vectors"]
TOLERANCE = 1e-6
LINES = (
    b"E4_Bvp 1680442024,64479 21,54169\r\n"
    b"R device_subscribe gsr OK\n"
    b"E4_Acc 1680442024.5 -1 2 63\r\n"
    b"R connection lost to device 9ff167\n"
    b"E4_Gsr 1680442024,73 0,0832364\r\n\r\n"
    b"nonsense\r\nE4_Tag 1680442031,5\r\n"
    b"R device_list 2 | 9ff167 Empatica_E4 | 7a3166 Empatica_E4 not_allowed\n"
)


def _chunks(vector: dict[str, Any]) -> list[bytes]:
    chunks: list[str] = vector.get("chunks") or [vector["message"]]
    return [
        bytes.fromhex(chunk[4:]) if chunk.startswith("hex:") else chunk.encode("utf-8")
        for chunk in chunks
        if chunk != "<EOF>"
    ]


def _check(message: Message, expected: dict[str, Any]) -> None:
    match message:
        case Sample():
            assert expected["kind"] == "sample"
            assert message.stream.value == expected["stream"]
            assert message.time_s == pytest.approx(expected["t"], abs=TOLERANCE, rel=0)
            assert message.values == pytest.approx(expected["values"], abs=TOLERANCE, rel=0)
        case Reply():
            assert expected["kind"] == "reply"
            assert message.command == expected["command"]
            assert message.accepted == (expected["status"] == "ok")
            assert message.subject == expected.get("stream", expected.get("state", ""))
        case Event():
            assert expected["kind"] == "event"
            assert message.event.value == expected["event"]
            assert message.device == expected["device"].lower()
        case Malformed():
            assert expected["kind"] == "error"
            assert message.flaw.value == expected["code"]
            if "raw" in expected:
                assert message.raw == expected["raw"]


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_vector(vector: dict[str, Any]) -> None:
    protocol = E4Protocol()
    messages = [message for chunk in _chunks(vector) for message in protocol.feed(chunk)]
    if "<EOF>" in vector.get("chunks", ()):
        messages += protocol.finish()
    expected = [each for each in vector["expect"] if each["kind"] != "closed"]
    assert len(messages) == len(expected)
    for message, wanted in zip(messages, expected, strict=True):
        _check(message, wanted)


def test_events_of_a_wristband_are_no_replies() -> None:
    (back, off) = E4Protocol().feed(
        b"R connection re-established to device 9FF167\nR device 9ff167 turned off via button\n"
    )
    assert isinstance(back, Event)
    assert isinstance(off, Event)
    assert (back.event.value, off.event.value) == ("ble_restored", "turned_off")
    assert back.device == off.device == "9ff167"


@pytest.mark.parametrize("time", ["0", "-1680442024", "1680442024644790", "1e11"])
def test_a_time_that_no_clock_reads_is_refused(time: str) -> None:
    line = f"E4_Bvp {time} 21,54169"
    (malformed,) = E4Protocol().feed(f"{line}\n".encode())
    assert malformed == Malformed(Flaw.BAD_NUMBER, line)


def test_a_device_list_says_who_may_connect() -> None:
    (reply,) = E4Protocol().feed(
        b"R device_discover_list 2 | 9FF167 Empatica_E4 allowed | 7a3166 Empatica_E4 not_allowed\n"
    )
    assert isinstance(reply, Reply)
    assert [(each.device, each.allowed) for each in reply.devices] == [
        ("9ff167", True),
        ("7a3166", False),
    ]


@pytest.mark.parametrize("word", ["ERR", "ERROR"])
def test_a_refusal_keeps_its_reason(word: str) -> None:
    (reply,) = E4Protocol().feed(f"R device_subscribe {word} You are not connected\n".encode())
    assert isinstance(reply, Reply)
    assert not reply.accepted
    assert reply.reason == "You are not connected"


def test_requests_end_as_every_server_accepts() -> None:
    assert request("device_subscribe", "bvp", "ON") == b"device_subscribe bvp ON\r\n"


def _split(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted({cut % (len(data) + 1) for cut in cuts}), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


NOISE = st.lists(
    st.one_of(
        st.binary(max_size=40),
        st.sampled_from([LINES, b"\r", b"\n", b"E4_", b"R ", b"E4_Bvp 1,5 2,5\r\n", b"E4_Acc "]),
        st.text(max_size=20).map(lambda text: text.encode("utf-8", "ignore")),
    ),
    max_size=12,
).map(b"".join)


@given(data=NOISE, cuts=st.lists(st.integers(0, 10_000), max_size=20))
def test_any_bytes_in_any_pieces_mean_the_same(data: bytes, cuts: list[int]) -> None:
    whole, pieces = E4Protocol(), E4Protocol()
    expected = [*whole.feed(data), *whole.finish()]
    messages = [message for part in _split(data, cuts) for message in pieces.feed(part)]
    messages += pieces.finish()
    assert messages == expected
    assert pieces.dropped_bytes == whole.dropped_bytes


@given(pieces=st.lists(st.integers(1, 30_000), min_size=1, max_size=12))
def test_a_runaway_line_is_dropped_once_and_never_kept(pieces: list[int]) -> None:
    protocol, messages = E4Protocol(), list[Message]()
    for size in pieces:
        messages += protocol.feed(b"x" * size)
        assert protocol.buffered <= MAX_LINE_BYTES
    messages += protocol.feed(b"\nR pause ON\n")
    flaws = [message.flaw.value for message in messages if isinstance(message, Malformed)]
    assert flaws == (["line_too_long"] if sum(pieces) > MAX_LINE_BYTES else ["unknown_line"])
    assert isinstance(messages[-1], Reply)
