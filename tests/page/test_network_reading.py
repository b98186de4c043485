"""What the page of the network reads of real outlets in another process, without a browser."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pylsl
import pytest

from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.page.downsampling import MAX_ROWS_HZ, key_of, window
from biosensor_gateway.page.models import SeenDeviceView, SeenState
from biosensor_gateway.page.network.source import Reader
from biosensor_gateway.page.network.stream import Placer
from biosensor_gateway.page.network.stream_list import MAX_INLETS
from biosensor_gateway.page.network.view import entry_of, readable

DEADLINE_S = 60.0
MANY = 100
"""Two ports each: more than the ports of a test have room for are not found without multicast."""

NAME = "<script>\u202e\n'; drop"
OTHERS: list[dict[str, Any]] = [
    {"name": "amplifier", "rate": 250.0, "channels": 128},
    {"name": NAME, "rate": 50.0, "label": "\u200b<b>{}", "source_id": ""},
    {"name": "large", "rate": 50.0, "header_bytes": 10_000_000},
    {"name": "unix time", "rate": 50.0, "stamps": "unix"},
    {"name": "experiment", "type": "Markers", "format": "string", "text": "trial {}\x07"},
]


@contextmanager
def other_streams(streams: Sequence[dict[str, Any]]) -> Generator[None]:
    """Run a program of somebody else with these streams."""
    command = [sys.executable, "-m", "tests.page.other_streams", json.dumps(streams)]
    process = subprocess.Popen(command)
    try:
        yield
    finally:
        process.kill()
        process.wait(DEADLINE_S)


class Reading:
    """A reader, and what it has read."""

    def __init__(self) -> None:
        self.samples: list[Samples] = []
        self.reader = Reader(self.samples.extend)

    def device(self, title: str) -> SeenDeviceView | None:
        found = [each for each in self.reader.view.devices if each.title == title]
        return found[0] if found else None

    def wait(self, title: str, *states: SeenState) -> SeenDeviceView:
        """Return a device once it is in one of these states."""

        def found() -> SeenDeviceView | None:
            device = self.device(title)
            return device if device and (not states or device.seen in states) else None

        return until(found)

    def values(self, key: str) -> np.ndarray[Any, Any]:
        return np.concatenate([each.values for each in list(self.samples) if each.source_id == key])

    def stamps(self, key: str) -> np.ndarray[Any, Any]:
        return np.concatenate([each.stamps for each in list(self.samples) if each.source_id == key])

    def count(self, key: str) -> int:
        return sum(len(each.stamps) for each in list(self.samples) if each.source_id == key)


def until(holds: Callable[[], Any]) -> Any:
    """Return what becomes true."""
    deadline = time.monotonic() + DEADLINE_S
    while not (found := holds()):
        assert time.monotonic() < deadline, "what was waited for never happened"
        time.sleep(0.02)
    return found


@pytest.fixture(scope="module")
def reading() -> Generator[Reading]:
    with other_streams(OTHERS):
        running = Reading()
        try:
            yield running
        finally:
            running.reader.stop()


@pytest.mark.seam
def test_it_is_what_was_sent_in_the_channels_that_were_asked_for(reading: Reading) -> None:
    device = reading.wait("amplifier", SeenState.LISTED)
    (stream,) = device.streams
    assert reading.reader.view.inlets == 0
    assert (stream.channel_count, stream.channels[-1], stream.units[0]) == (128, "C8", "microvolts")
    first, last = stream.source_id, key_of(int(stream.source_id), 120)
    reading.reader.wanted = frozenset({first, last})
    until(lambda: reading.count(first) > 500 and reading.count(last) > 500)
    numbers = reading.values(first)[:, 0]
    assert (np.diff(numbers) == 1).all()
    for key, begin in ((first, 0), (last, 120)):
        values = reading.values(key)[: len(numbers)]
        expected = np.add.outer(numbers, 1000.0 * np.arange(begin, begin + 8))
        assert (values == expected[: len(values)]).all()
    steps = np.diff(reading.stamps(first))
    # Where the sender's clock is known late, one step is that to the right time.
    assert np.median(np.abs(steps - 1 / 250)) < 0.0001
    assert steps.min() >= 0
    # An inlet of its own on the same stream: both clocks are this machine's.
    (info,) = pylsl.resolve_byprop("name", "amplifier", timeout=DEADLINE_S)
    rows, stamps = pylsl.StreamInlet(info).pull_chunk(DEADLINE_S, max_samples=1)
    until(lambda: reading.values(first)[-1, 0] > rows[0][0])
    place = np.flatnonzero(reading.values(first)[:, 0] == rows[0][0])[0]
    assert reading.stamps(first)[place] == pytest.approx(stamps[0], abs=0.05)
    (stream,) = reading.wait("amplifier", SeenState.STREAMING).streams
    assert stream.windows[120].channels == [f"C{number}" for number in range(121, 129)]
    assert stream.measured_hz == pytest.approx(250, rel=0.05)


@pytest.mark.nightly
def test_streams_of_strangers_do_no_harm(reading: Reading) -> None:
    shown = readable(NAME)
    assert shown == "<script>\\u202e\\n'; drop"
    titles = (shown, "large", "unix time")
    streams = [reading.wait(title).streams[0] for title in titles]
    reading.reader.wanted = frozenset(each.source_id for each in streams)
    strange, large, unix = (reading.wait(title, SeenState.STREAMING).streams[0] for title in titles)
    assert strange.lsl_name == shown
    assert strange.channels[0].startswith("\\u200b")
    assert "not usable" in large.note
    assert large.channels == ["1"]
    assert "another clock" in unix.note
    assert unix.age_s is not None
    assert unix.age_s < 5


@pytest.mark.nightly
def test_text_is_read_as_text(reading: Reading) -> None:
    (stream,) = reading.wait("experiment").streams
    reading.reader.wanted = frozenset({stream.source_id})
    (stream,) = until(lambda: [s for s in reading.wait("experiment").streams if s.texts])
    assert stream.texts[0].text.startswith("trial ")
    assert stream.texts[0].text.endswith("\\x07")
    assert stream.channels == []
    assert not reading.count(stream.source_id)


@pytest.mark.nightly
def test_of_very_many_streams_few_are_received(reading: Reading) -> None:
    def many() -> list[str]:
        devices = reading.reader.view.devices
        streams = (each for device in devices for each in device.streams)
        return [each.source_id for each in streams if each.lsl_name.startswith("many-")]

    with other_streams([{"name": f"many-{number}", "rate": 1.0} for number in range(MANY)]):
        reading.reader.wanted = frozenset()
        until(lambda: reading.reader.view.inlets == 0)
        keys = until(lambda: found if len(found := many()) == MANY else None)
        reading.reader.wanted = frozenset(keys)
        until(lambda: reading.reader.view.inlets == MAX_INLETS)
        assert reading.reader.view.not_received == MANY - MAX_INLETS
        reading.reader.wanted = frozenset()
        until(lambda: reading.reader.view.inlets == 0)


def test_a_fast_stream_keeps_its_smallest_and_largest_values() -> None:
    rate, seconds = 44_100, 2
    times = 1000.0 + np.arange(rate * seconds) / rate
    values = np.zeros((len(times), 1))
    values[[1000, 50_000], 0] = 7.0, -9.0
    found = window("1", times, values, 0, rate)
    assert len(found.stamps) <= MAX_ROWS_HZ * seconds + 4
    assert (found.values.max(), found.values.min()) == (7.0, -9.0)
    assert (np.diff(found.stamps) > 0).all()
    assert abs(found.stamps[np.argmax(found.values)] - times[1000]) < 0.004


def test_what_is_not_finite_is_no_value() -> None:
    values = np.array([[1e300, np.inf], [np.nan, 2.0]])
    found = window("1", np.array([1.0, 2.0]), values, 0, 10.0)
    assert np.isnan(found.values[[0, 0, 1], [0, 1, 0]]).all()
    assert found.values[1, 1] == 2.0


class TestPlacing:
    """Stamps of other computers become local times, whatever they are."""

    def test_the_measured_correction_counts(self) -> None:
        placer = Placer()
        placer.correction = 90.0
        assert placer.place(np.array([10.0, 10.1]), 100.2).tolist() == [100.0, 100.1]
        assert not placer.is_by_arrival

    @pytest.mark.parametrize("stamps", [[1.8e9, 1.8e9 + 1], [np.nan, 5.0], [-np.inf, 1e300]])
    def test_stamps_of_another_clock_are_placed_by_arrival(self, stamps: list[float]) -> None:
        placer = Placer()
        placer.correction = 0.0
        times = placer.place(np.array(stamps), 100.0)
        assert placer.is_by_arrival
        assert times[-1] == 100.0
        assert (np.diff(times) >= 0).all()

    def test_time_never_runs_back(self) -> None:
        placer = Placer()
        placer.correction = 0.0
        placer.place(np.array([99.0]), 100.0)
        assert placer.place(np.array([98.0, 99.5]), 100.1).tolist() == [99.0, 99.5]

    def test_a_state_of_ours_keeps_its_stamp_however_old(self) -> None:
        placer = Placer(is_ours=True)
        placer.correction = 0.0
        assert placer.place(np.array([5.0]), 1000.0).tolist() == [5.0]
        assert not placer.is_by_arrival


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ('{"event":"gap","device":"zephyr/1","lsl_time":1}', "gap: zephyr/1"),
        ("[[[[", "[[[["),
        ("[" * 100_000, "[" * 199 + "…"),
        ("plain", "plain"),
    ],
)
def test_what_an_agent_says_is_read_out_of_its_json(text: str, shown: str) -> None:
    assert entry_of(text, is_ours=True) == shown
