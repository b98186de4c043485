"""What the page of the network reads of outlets, and what a script gets of it."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pylsl
import pytest

from biosensor_common.lsl.inlet import Block
from biosensor_common.lsl.network import numbered
from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import foreign_header
from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.page.downsampling import MAX_ROWS_HZ, chosen, key_of, window
from biosensor_gateway.page.models import NetworkView, SeenDeviceView, SeenState
from biosensor_gateway.page.network.network_stream import Placer
from biosensor_gateway.page.network.network_thread import NetworkSource, Reader
from biosensor_gateway.page.network.stream_list import MAX_INLETS, StreamList
from biosensor_gateway.page.network.view import Viewer, entry_of, readable
from biosensor_gateway.page.pages import network_interface
from biosensor_gateway.streaming.counters import Counters, counters_text
from tests.rigs.polling import wait_until
from tests.ros.test_aliases import Info

# What the page of the network reads of real outlets in another process, without a browser.

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
    """Run another user's program with these streams."""
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

        return wait_until(found)

    def values(self, key: str) -> np.ndarray[Any, Any]:
        return np.concatenate([each.values for each in list(self.samples) if each.source_id == key])

    def stamps(self, key: str) -> np.ndarray[Any, Any]:
        return np.concatenate([each.stamps for each in list(self.samples) if each.source_id == key])

    def count(self, key: str) -> int:
        return sum(len(each.stamps) for each in list(self.samples) if each.source_id == key)


@pytest.fixture(scope="module")
def reading() -> Generator[Reading]:
    with other_streams(OTHERS):
        running = Reading()
        try:
            yield running
        finally:
            running.reader.stop()


def test_a_key_names_the_channels_that_a_browser_asks_for() -> None:
    assert chosen([key_of(7), key_of(7, 8), key_of(12, 120)]) == {7: {0, 8}, 12: {120}}
    assert chosen(["", "7:x", "-1", "7" * 20]) == {}


@pytest.mark.seam
def test_it_is_what_was_sent_in_the_channels_that_were_asked_for(reading: Reading) -> None:
    device = reading.wait("amplifier", SeenState.LISTED)
    (stream,) = device.streams
    assert reading.reader.view.inlets == 0
    assert (stream.channel_count, stream.channels[-1], stream.units[0]) == (128, "C8", "microvolts")
    first, last = stream.source_id, key_of(int(stream.source_id), 120)
    reading.reader.wanted = frozenset({first, last})
    wait_until(lambda: reading.count(first) > 500 and reading.count(last) > 500)
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
    wait_until(lambda: reading.values(first)[-1, 0] > rows[0][0])
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
    (stream,) = wait_until(lambda: [s for s in reading.wait("experiment").streams if s.texts])
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
        wait_until(lambda: reading.reader.view.inlets == 0)
        keys = wait_until(lambda: found if len(found := many()) == MANY else None)
        reading.reader.wanted = frozenset(keys)
        wait_until(lambda: reading.reader.view.inlets == MAX_INLETS)
        assert reading.reader.view.not_received == MANY - MAX_INLETS
        reading.reader.wanted = frozenset()
        wait_until(lambda: reading.reader.view.inlets == 0)


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


# Senders that claim to be one stream have the topics that a node gives them.
NOW_S = 1000.0
FIRST, SECOND = Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0)
OTHER_FORMAT = Info("3", "stim-pc", 2.5, 1)


class Page:
    """A page that looks at senders."""

    def __init__(self) -> None:
        self.listing = StreamList()
        self._now_s = NOW_S

    def look(self, *present: Any, after_s: float = 10.0) -> dict[str, str]:
        """Look for some time; return the topics of the senders."""
        for _ in range(int(after_s)):
            self._now_s += 1.0
            self.listing.update(present, self._now_s)
        for each in self.listing.streams.values():
            each.header = numbered(foreign_header(each.core), each.namesake)
        view = Viewer().view(self.listing, 0, (), self._now_s)
        topics = {each.source_id: each.topic for of in view.devices for each in of.streams}
        return {each.uid: topics[str(n)] for n, each in self.listing.streams.items()}


def test_each_has_its_number_whichever_was_found_first() -> None:
    one, two, three = (f"/biosensors/MyMarkerStream/Markers{end}" for end in ("", "_2", "_3"))
    assert Page().look(OTHER_FORMAT, SECOND, FIRST) == {"1": one, "2": two, "3": three}
    assert Page().look(SECOND) == {"2": one}


def test_one_that_starts_again_keeps_it() -> None:
    page = Page()
    page.look(FIRST, SECOND)
    page.look(FIRST)
    again = Info("4", "stim-pc", 9.0)
    assert page.look(FIRST, again) == {
        "1": "/biosensors/MyMarkerStream/Markers",
        "4": "/biosensors/MyMarkerStream/Markers_2",
    }


@pytest.mark.parametrize(("state", "said"), [("connecting", "connecting"), ("paused", "paused")])
def test_last_values_of_a_sensor_that_is_away_are_not_of_now(state: str, said: str) -> None:
    """Of one whose streams are all irregular, nothing else tells that it is away."""
    strap = DeviceIdentity("ble_heart_rate", "A1", "P01")
    battery, counts = Info("1", "lab-pc", 1.0, 1), Info("2", "lab-pc", 1.0)
    vars(battery)["_told"] |= {
        "name": "bat",
        "type": "Battery",
        "source_id": source_id(strap, "bat"),
    }
    vars(counts)["_told"] |= {"type": "Counters", "source_id": "gateway-pc-counters"}
    senders: Any = [battery, counts]
    listing = StreamList()
    listing.update(senders, NOW_S)
    of_bat, of_counts = listing.streams.values()
    for stream, identity in ((of_bat, strap), (of_counts, DeviceIdentity("gateway", "pc"))):
        header = foreign_header(stream.core)
        stream.header = replace(header, identity=identity, foreign=False)
    of_bat.receiver = cast("Any", SimpleNamespace(correction=0.0, age_s=1.0))
    of_bat.received.placer.correction = 0.0
    of_bat.received.take(Block(np.array([[77.0]]), np.array([NOW_S])), NOW_S)

    def shown(away: dict[str, str]) -> tuple[bool, list[float | None], str]:
        told = counters_text({of_bat.core.source_id: Counters()}, away=away)
        of_counts.received.raw = told.encode()
        view = Viewer().view(listing, 0, (), NOW_S)
        (seen,) = (each for of in view.devices for each in of.streams if each.lsl_name == "bat")
        return seen.is_fresh, seen.values, seen.note

    assert shown({})[:2] == (True, [77.0])
    assert shown({of_bat.core.source_id: state}) == (
        False,
        [],
        f"its sensor does not send: {said}",
    )


def test_what_the_agent_says_of_its_stream_stands_with_it() -> None:
    strap = DeviceIdentity("polar_h10", "A1", "P01")
    heart, counts = Info("1", "lab-pc", 1.0, 4), Info("2", "lab-pc", 1.0)
    vars(heart)["_told"] |= {"name": "hr", "type": "HR", "source_id": source_id(strap, "hr")}
    vars(counts)["_told"] |= {"type": "Counters", "source_id": "gateway-pc-counters"}
    senders: Any = [heart, counts]
    listing = StreamList()
    listing.update(senders, NOW_S)
    of_hr, of_counts = listing.streams.values()
    for stream, identity in ((of_hr, strap), (of_counts, DeviceIdentity("gateway", "pc"))):
        header = foreign_header(stream.core)
        stream.header = replace(header, identity=identity, foreign=False)
    refused = {of_hr.core.source_id: ["2 samples were not sent: hr was 500"]}
    told = counters_text({each: Counters(lost=3) for each in refused}, refused=refused)
    of_counts.received.raw = told.encode()
    view = Viewer().view(listing, 0, (), NOW_S)
    (shown,) = (each for of in view.devices for each in of.streams if each.lsl_name == "hr")
    assert (shown.note, shown.lost) == ("2 samples were not sent: hr was 500", 3)


# What a script gets of the network's page: the streams as JSON.
class Source:
    """Sees nothing yet."""

    def status(self) -> NetworkView:
        return NetworkView(made_s=1.0, search=["Start an agent."])


def test_the_streams_are_answered_as_json() -> None:
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b""}

    async def send(message: Any) -> None:
        sent.append(message)

    scope: dict[str, Any] = {
        "type": "http",
        "method": "GET",
        "path": "/api/v1/streams",
        "query_string": b"",
        "headers": [],
    }
    app: Any = network_interface(cast("NetworkSource", Source()))
    asyncio.run(app(scope, receive, send))
    assert sent[0]["status"] == 200
    told = json.loads(b"".join(each.get("body", b"") for each in sent))
    assert (told["made_s"], told["search"]) == (1.0, ["Start an agent."])
