"""What a pause holds back, sample by sample: real outlets, real inlets."""

from __future__ import annotations

from collections.abc import Callable, Generator

import pylsl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming import outlets as outlets_module
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.streaming.stages import RESUME_GUARD_S, PauseGate

OpenInlet = Callable[[str], pylsl.StreamInlet]
Until = Callable[[Callable[[], bool]], None]
AHEAD_S = 20.0
"""Stamps so far ahead are still on the LSL clock; so tests need not wait for a guard to end."""


@pytest.fixture
def sink(unit: str) -> Generator[DeviceSink]:
    opened = DeviceSink(DeviceIdentity("empatica_e4", unit), declaration("empatica_e4"))
    opened.open(DeviceInfo(), {})
    yield opened
    opened.close()


def source(sink: DeviceSink, data_name: str) -> str:
    return naming.source_id(sink.identity, data_name)


def counters(sink: DeviceSink, data_name: str) -> Counters:
    return sink.counters[source(sink, data_name)]


def pulled(reader: pylsl.StreamInlet, until: Until, last: object) -> list[object]:
    """Return the first channel of all that comes up to a value."""
    values: list[object] = []

    def has_come() -> bool:
        samples, _ = reader.pull_chunk(timeout=0.0)
        values.extend(row[0] for row in samples)
        return last in values

    until(has_come)
    return values


@pytest.mark.nightly
def test_not_one_sample_of_a_pause_is_sent(
    sink: DeviceSink, inlet: OpenInlet, until: Until
) -> None:
    reader = inlet(source(sink, "bvp"))
    sink.emit_at("bvp", [1.0, 2.0], [pylsl.local_clock() - 0.2, pylsl.local_clock() - 0.1])
    before_s = pylsl.local_clock()
    sink.pause()
    # Measured before, and in work when the pause began.
    sink.emit_at("bvp", [3.0], [before_s - 0.05])
    sink.emit_at("bvp", [4.0, 5.0], [before_s, before_s + AHEAD_S])
    sink.resume()
    after_s = pylsl.local_clock()
    # Measured in the pause, and in work when it ended; the last one is as late as a guard is.
    guard_ends_s = after_s + RESUME_GUARD_S
    sink.emit_at("bvp", [6.0, 7.0], [before_s + 1e-4, guard_ends_s - 0.1])
    # Of one packet, what was measured later is sent.
    sink.emit_at("bvp", [8.0, 9.0, 10.0], [after_s, guard_ends_s, guard_ends_s + 0.1])
    assert pulled(reader, until, 10.0) == [1.0, 2.0, 9.0, 10.0]
    counted = counters(sink, "bvp")
    assert (counted.pushed, counted.withheld, counted.refused, counted.lost) == (4, 6, 0, 0)
    assert counted.last_stamp == guard_ends_s + 0.1


@pytest.mark.nightly
def test_withheld_samples_do_not_move_the_stamps_of_those_after(
    sink: DeviceSink, inlet: OpenInlet
) -> None:
    reader = inlet(source(sink, "bvp"))
    sink.pause()
    now = pylsl.local_clock()
    sink.emit_at("bvp", [1.0], [now + AHEAD_S])
    sink.resume()
    stamp = pylsl.local_clock() + RESUME_GUARD_S + 0.5
    sink.emit_at("bvp", [2.0], [stamp])
    assert reader.pull_sample(timeout=20.0) == ([2.0], stamp)


@pytest.mark.parametrize("rows", [[[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]])
def test_samples_of_several_channels_are_withheld_whole(
    sink: DeviceSink, rows: list[list[float]]
) -> None:
    sink.pause()
    sink.emit_at("acc", rows, [pylsl.local_clock()] * len(rows))
    assert counters(sink, "acc") == Counters(withheld=len(rows))


@pytest.mark.nightly
def test_text_is_withheld_as_well(sink: DeviceSink, inlet: OpenInlet, until: Until) -> None:
    reader = inlet(source(sink, "tag"))
    now = pylsl.local_clock()
    sink.observe(now, now)
    sink.emit_text("tag", "before", now)
    sink.pause()
    sink.emit_text("tag", "during", pylsl.local_clock())
    sink.emit_text("tag", "during", pylsl.local_clock() + AHEAD_S)
    sink.resume()
    sink.emit_text("tag", "in work", pylsl.local_clock())
    sink.emit_text("tag", "after", pylsl.local_clock() + RESUME_GUARD_S + 0.1)
    assert pulled(reader, until, "after") == ["before", "after"]
    assert (counters(sink, "tag").pushed, counters(sink, "tag").withheld) == (2, 3)


@pytest.mark.nightly
def test_states_that_wait_for_a_receiver_are_withdrawn_too(
    monkeypatch: pytest.MonkeyPatch, unit: str, inlet: OpenInlet, until: Until
) -> None:
    monkeypatch.setattr(outlets_module, "ATTACH_TIME_S", 0.0)
    sink = DeviceSink(DeviceIdentity("empatica_e4", unit), declaration("empatica_e4"))
    sink.open(DeviceInfo(), {})
    sink.emit_at("bat", [71.0], [pylsl.local_clock()])
    sink.pause()
    assert counters(sink, "bat") == Counters(withheld=1)
    reader = inlet(source(sink, "bat"))
    sink.release()
    sink.emit_at("bat", [72.0], [pylsl.local_clock()])
    sink.resume()
    sink.release()
    sink.emit_at("bat", [73.0], [pylsl.local_clock() + RESUME_GUARD_S + 0.1])

    def released() -> bool:
        sink.release()
        return counters(sink, "bat").pushed == 1

    until(released)
    assert pulled(reader, until, 73.0) == [73.0]
    assert counters(sink, "bat").withheld == 2
    sink.close()


def test_outlets_of_a_paused_device_come_with_it_and_stay_empty(unit: str) -> None:
    sink = DeviceSink(DeviceIdentity("empatica_e4", unit), declaration("empatica_e4"))
    sink.pause()
    sink.open(DeviceInfo(), {})
    sink.emit_at("bvp", [1.0], [pylsl.local_clock()])
    assert counters(sink, "bvp") == Counters(withheld=1)
    sink.close()


def test_a_second_pause_does_not_shorten_the_first(sink: DeviceSink) -> None:
    sink.pause()
    sink.pause()
    assert sink.is_paused
    sink.resume()
    sink.resume()
    assert not sink.is_paused


def test_what_does_not_fit_its_times_is_refused_and_nothing_else(sink: DeviceSink) -> None:
    sink.pause()
    sink.resume()
    now = pylsl.local_clock()
    sink.emit_at("bvp", [1.0], [now, now + AHEAD_S])
    assert counters(sink, "bvp") == Counters(refused=2)


def test_losses_of_a_pause_are_none(sink: DeviceSink) -> None:
    sink.emit_at("bvp", [1.0], [pylsl.local_clock()])
    sink.lost("bvp", 5)
    sink.pause()
    for ahead_s in (0.0, 1.0):
        sink.emit_at("bvp", [1.0], [pylsl.local_clock() + ahead_s])
    sink.lost("bvp", 1000)
    # Before the first sample there is nothing to tell from when it is missing.
    sink.lost("acc", 1000)
    assert counters(sink, "bvp").lost == 5
    assert counters(sink, "acc").lost == 0


def test_of_a_gap_that_was_partly_paused_the_rest_is_lost(sink: DeviceSink) -> None:
    now = pylsl.local_clock()
    sink.emit_at("bvp", [1.0], [now - 10.0])
    sink.pause()
    sink.resume()
    # Ten seconds unpaused, then a pause and its guard of one second together.
    sink.emit_at("bvp", [2.0], [now + RESUME_GUARD_S + 0.001])
    sink.lost("bvp", 1100)
    assert counters(sink, "bvp").lost == pytest.approx(1000, abs=15)


@given(
    edges=st.lists(st.integers(0, 1000), min_size=4, max_size=4, unique=True).map(sorted),
    span=st.lists(st.integers(-10, 1010), min_size=2, max_size=2, unique=True).map(sorted),
)
def test_the_share_of_a_span_is_what_lies_in_the_pauses(edges: list[int], span: list[int]) -> None:
    withheld = PauseGate()
    for begin, end in (edges[:2], edges[2:]):
        withheld.begin(float(begin * 10))
        withheld.end(end * 10 - RESUME_GUARD_S)
    inside = sum(
        any(begin * 10 <= moment < end * 10 for begin, end in (edges[:2], edges[2:]))
        for moment in range(span[0] * 10, span[1] * 10)
    )
    assert withheld.share(span[0] * 10.0, span[1] * 10.0) == pytest.approx(
        inside / (span[1] * 10 - span[0] * 10)
    )
