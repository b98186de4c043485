"""Every sample arrives in ROS once, and is what the page's button records."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pylsl
import pytest
import pyxdf
from numpy.typing import NDArray
from playwright.sync_api import Page, expect
from std_msgs.msg import Float32, Float32MultiArray, String

from biosensor_common.errors import GatewayError
from biosensor_gateway.agent import control
from biosensor_gateway.devices.zephyr.simulator.wire import Packet
from biosensor_gateway.devices.zephyr.simulator.zephyr import SyntheticSource
from biosensor_gateway.settings.places import state_folder
from tests.rigs.chromium import chromium
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.polling import wait_until
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

# Every sample that the device sent arrives in ROS once, in order, raw and in chunks.

Values = NDArray[np.float32]
SETTLE_S = 3.0
BEFORE_CABLE_S = 20.0
CABLE_OUT_S = 3.0
AFTER_CABLE_S = 7.0
CHUNK_LENGTHS = (50, 128, 20, 77)
_ALIGN = 100
_TOPIC_OF = {Packet.ECG: "ecg", Packet.BREATHING: "breathing", Packet.ACCELERATION: "acc"}
_CHUNK_OF = {"ecg": "ecg_chunk", "breathing": "br_chunk"}


def _truth(device: SteeredBioHarness, packet: Packet) -> tuple[NDArray[np.int64], Values]:
    rows = device.sent_samples(packet)
    values = rows[:, 1:].astype(np.float64)
    if packet is Packet.ACCELERATION:
        values = (values - 512) / 20.75
    return rows[:, 0], values.astype(np.float32)


def _start_of(part: Values, whole: Values) -> int:
    """Where *part* begins in *whole*; it must be there exactly once."""
    windows = np.lib.stride_tricks.sliding_window_view(whole, len(part), axis=0)
    matches = (windows.transpose(0, 2, 1) == part).all(axis=(1, 2)).nonzero()[0]
    assert len(matches) == 1, f"{len(matches)} places fit"
    return int(matches[0])


def _common_length(a: Values, b: Values) -> int:
    size = min(len(a), len(b))
    differs = (a[:size] != b[:size]).any(axis=1).nonzero()[0]
    return int(differs[0]) if len(differs) else size


class Match(NamedTuple):
    """Received = body[first:cut] then body[back:], by index of the device's samples."""

    first: int
    cut: int
    back: int
    end: int


def _match(received: Values, body: Values) -> Match:
    """Match what was received against all that the body did, with one gap."""
    first = _start_of(received[:_ALIGN], body)
    before = _common_length(received, body[first:])
    cut = first + before
    if before == len(received):
        return Match(first, cut, cut, cut)
    back = _start_of(received[before : before + _ALIGN], body)
    after = _common_length(received[before:], body[back:])
    assert before + after == len(received), "a second gap, or a sample that was never measured"
    return Match(first, cut, back, back + after)


def _raw(messages: list[Any]) -> Values:
    return np.array([np.atleast_1d(message.data) for message in messages], dtype=np.float32)


def _chunks(messages: list[Any]) -> list[Values]:
    shaped: list[Values] = []
    for message in messages:
        samples, channels = message.layout.dim
        assert (samples.label, channels.label) == ("samples", "channels")
        assert (samples.stride, channels.stride) == (len(message.data), channels.size)
        chunk = np.array(message.data, dtype=np.float32).reshape(samples.size, channels.size)
        shaped.append(chunk)
    return shaped


def test_every_sample_arrives_once(
    programs: Any,
    listener: Any,
) -> None:
    topics = {
        "ecg": Float32,
        "breathing": Float32,
        "acc": Float32MultiArray,
        "ecg_chunk": Float32MultiArray,
        "br_chunk": Float32MultiArray,
    }
    received = {
        topic: listener.listen(kind, f"/biosensors/zephyr/{topic}")
        for topic, kind in topics.items()
    }
    with SteeredBioHarness(SyntheticSource(seed=7)) as device:
        programs.agent(f'[[device]]\nsensor = "zephyr"\nunit = "SIM1"\nport = "{device.port}"\n')
        programs.node("Chunk_Length:=50")
        wait_until(lambda: all(received.values()), f"all of {list(topics)}")
        time.sleep(SETTLE_S)
        start = {topic: len(messages) for topic, messages in received.items()}

        for length in CHUNK_LENGTHS[1:]:
            time.sleep(BEFORE_CABLE_S / len(CHUNK_LENGTHS))
            (result,) = listener.set_parameters("lsl_to_ros", {"Chunk_Length": length})
            assert result.successful, result.reason
        time.sleep(BEFORE_CABLE_S / len(CHUNK_LENGTHS))

        device.drop_link(CABLE_OUT_S)
        at_cut = len(received["ecg"])
        wait_until(lambda: len(received["ecg"]) > at_cut + 500, "samples after the cable is back")
        time.sleep(AFTER_CABLE_S)
        device.stall()
        truth = {packet: _truth(device, packet) for packet in _TOPIC_OF}
        for packet, topic in _TOPIC_OF.items():
            last = truth[packet][1][-20:]
            wait_until(
                lambda topic=topic, last=last: np.array_equal(_raw(received[topic][-20:]), last),
                f"the last sample sent on {topic}",
            )
        time.sleep(1.5)
        status = programs.status()

    lost = {
        source.rpartition("-")[2]: counters["lost"]
        for source, counters in status["devices"][0]["streams"].items()
    }
    for packet, topic in _TOPIC_OF.items():
        indices, values = truth[packet]
        body = np.full((indices[-1] + 1, values.shape[1]), np.nan, dtype=np.float32)
        body[indices] = values
        raw = _raw(received[topic][start[topic] :])
        match = _match(raw, body)
        assert match.end == len(body), "what was sent last is missing"
        assert match.back > match.cut, "the cable made no gap"
        assert lost[topic] == match.back - match.cut
        if topic in _CHUNK_OF:
            chunks = _chunks(received[_CHUNK_OF[topic]][start[_CHUNK_OF[topic]] :])
            _check_chunks(chunks, body, match, rate_fills_all=topic == "ecg")


def _check_chunks(
    chunks: list[Values], body: Values, match: Match, *, rate_fills_all: bool
) -> None:
    """Chunks follow each other without a hole but at the gap, where a partial one is given up."""
    position = _start_of(chunks[0], body)
    lengths: list[int] = []
    longest = max(CHUNK_LENGTHS)
    for chunk in chunks:
        if not np.array_equal(chunk, body[position : position + len(chunk)]):
            assert position <= match.cut < position + longest, "a chunk is missing"
            position = match.back
            assert np.array_equal(chunk, body[position : position + len(chunk)])
        position += len(chunk)
        lengths.append(len(chunk))
    assert match.back < position <= match.end < position + longest
    # In the order in which they were set; a slow stream may fill no chunk of a long one.
    assert list(dict.fromkeys(lengths)) == [n for n in CHUNK_LENGTHS if n in lengths]
    if rate_fills_all:
        assert set(lengths) == set(CHUNK_LENGTHS)


# What the page's button records, and what ROS has, are the same samples, markers included.
RECORD_S = 6.0
DEADLINE_MS = 60_000
SETTINGS = """
[markers]
buttons = ["baseline"]

[[device]]
sensor = "zephyr"
unit = "A"
port = "{port}"
"""
TYPES = {"ecg": Float32, "breathing": Float32, "acc": Float32MultiArray}
_ADDRESS = re.compile(r"http://\S+")
_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def _rows(messages: list[Any]) -> NDArray[np.float32]:
    return np.array([np.atleast_1d(each.data) for each in messages], np.float32)


def _is_part(part: NDArray[np.float32], whole: NDArray[np.float32]) -> bool:
    """Whether rows are somewhere in others, one after the other without a gap."""
    return any(
        (whole[first : first + len(part)] == part).all()
        for first in range(len(whole) - len(part) + 1)
    )


def _use(page: Page, address: str, folder: Path) -> None:
    page.goto(address)
    session = page.get_by_role("region", name="Recording")
    session.get_by_label("Participant").fill("p01")
    session.get_by_label("Folder").fill(str(folder))
    session.get_by_role("button", name="Record").click()
    expect(session.get_by_text("recording, all streams are growing")).to_be_visible(
        timeout=DEADLINE_MS
    )
    markers = page.get_by_role("region", name="Markers")
    markers.get_by_role("button", name="baseline").click()
    markers.get_by_label("Note").fill("the robot stopped")
    markers.get_by_role("button", name="Send note").click()
    expect(markers.locator("li", has_text="the robot stopped")).to_be_visible()
    time.sleep(RECORD_S)
    session.get_by_role("button", name="Stop recording").click()
    expect(session.locator(".verdict")).to_be_visible(timeout=DEADLINE_MS)


def test_the_file_and_the_topics_hold_the_same(
    programs: Any, listener: Any, tmp_path: Path
) -> None:
    heard = {
        name: listener.listen(kind, f"/biosensors/zephyr/{name}") for name, kind in TYPES.items()
    }
    told = listener.listen(String, "/biosensors/gateway/markers")
    programs.node()
    with SteeredBioHarness() as device, chromium() as browser:
        programs.agent(SETTINGS.format(port=device.port))
        wait_until(lambda: all(heard.values()), "topics of the device")
        server = programs.start(
            "biosensor_gateway.cli",
            "page",
            "--no-open",
            "--settings",
            str(tmp_path / "settings.toml"),
        )
        wait_until(lambda: _ADDRESS.search(programs.log(server)), "the page's address")
        found = _ADDRESS.search(programs.log(server))
        assert found is not None
        _use(browser.new_page(), found[0], tmp_path / "recordings")

    (file,) = (tmp_path / "recordings").rglob("*.xdf")
    streams, _ = _load_xdf(str(file), synchronize_clocks=False, dejitter_timestamps=False)
    recorded = {
        each["info"]["desc"][0]["biosensor"][0]["data_name"][0]: each["time_series"]
        for each in streams
    }
    for name, messages in heard.items():
        values = np.asarray(recorded[name], np.float32)
        assert len(values) > 10 * RECORD_S, name
        assert _is_part(values, _rows(messages)), name
    markers = [text for (text,) in recorded["markers"]]
    said = [json.loads(text)["marker"] for text in markers]
    assert [each for each in said if each != "ready"] == ["baseline", "note"]
    in_ros = [message.data for message in told]
    assert in_ros[-len(markers) :] == markers


# Events, markers and features reach ROS as they were sent.

# The agent's events reach ROS as a topic, with nothing said of them on the ROS side.


def test_events_are_a_topic_of_strings(programs: Any, listener: Any) -> None:
    messages = listener.listen(String, "/biosensors/gateway/events")
    programs.node()
    with SteeredBioHarness() as device:
        programs.agent(
            f'[[device]]\nsensor = "zephyr"\nunit = "SIM3"\nport = "{device.port}"\n'
            "[events]\nheartbeat_s = 1\n"
        )

        def heard(kind: str) -> list[dict[str, Any]]:
            events = [json.loads(message.data) for message in messages]
            return [event for event in events if event["event"] == kind]

        wait_until(
            lambda: any("streaming" in beat["devices"].values() for beat in heard("heartbeat")),
            "a sign of life",
        )
        device.drop_link(2.0)
        wait_until(lambda: heard("gap_end"), "the end of the gap")
    for kind in ("disconnected", "gap_start", "gap_end"):
        (event, *_) = heard(kind)
        assert (event["sensor"], event["unit"]) == ("zephyr", "SIM3")
    assert heard("gap_end")[0]["lost"]["ecg"] > 0


# A marker of the experimenter reaches ROS, with nothing said of it on the ROS side.
@pytest.mark.seam
def test_a_marker_is_a_string_with_its_text(programs: Any, listener: Any) -> None:
    messages = listener.listen(String, "/biosensors/gateway/markers")
    programs.node()
    programs.agent("")

    def marked() -> dict[str, Any]:
        return control.ask(state_folder(), "mark", {"marker": "Stück 1", "kind": "button"})

    def heard() -> list[dict[str, Any]]:
        return [json.loads(message.data) for message in messages]

    def is_heard() -> bool:
        # Until the node and its subscriber are there, nobody hears a marker.
        with suppress(GatewayError):
            marked()
        return bool(heard())

    wait_until(is_heard, "a first marker")
    sent = marked()
    wait_until(lambda: heard()[-1]["id"] == sent["id"], "the marker")
    assert heard()[-1] == {"marker": "Stück 1", "kind": "button", **sent}
    undone = control.ask(state_folder(), "undo-marker")
    wait_until(lambda: heard()[-1]["id"] == undone["id"], "its undoing")
    assert (heard()[-1]["kind"], heard()[-1]["of"]) == ("undo", sent["id"])
    ids = [each["id"] for each in heard()]
    assert ids == list(range(ids[0], undone["id"] + 1))


# Features of a virtual strap arrive in ROS, and are those that its recording gives.
# What the features are computed of, and what the topics and the recording are compared by.
WANTED = {"ecg", "acc", "beats", "hr_live", "ecg_sqi", "activity_live"}
LEAST_BEATS = 12


def _by_data(path: Path) -> dict[str, Any]:
    reader: Any = pyxdf
    loaded: tuple[Any, Any] = reader.load_xdf(
        path, synchronize_clocks=False, dejitter_timestamps=False
    )
    return {each["info"]["source_id"][0].rpartition("-")[2]: each for each in loaded[0]}


def test_a_virtual_strap_gives_beats_in_ros_and_the_same_from_its_recording(
    programs: Any, listener: Any, tmp_path: Path
) -> None:
    path, again = tmp_path / "study.xdf", tmp_path / "again.xdf"
    programs.node()
    programs.start("biosensor_gateway.cli", "features")
    programs.start("biosensor_gateway.cli", "run", "--simulate", "polar_h10")

    def is_there(name: str) -> bool:
        return f"/biosensors/polar_h10/{name}" in dict(listener.node.get_topic_names_and_types())

    wait_until(lambda: is_there("ecg_sqi") and is_there("activity_live"), "topics of features")
    beats = listener.listen(Float32MultiArray, "/biosensors/polar_h10/beats")
    rates = listener.listen(Float32, "/biosensors/polar_h10/hr_live")
    resolver = pylsl.ContinuousResolver()

    def names() -> set[str]:
        return {each.source_id().rpartition("-")[2] for each in resolver.results()}

    wait_until(lambda: names() >= WANTED, "streams of the strap and of its features")
    # It looks for a second only and may miss any of them.
    with LabRecorder(path, at_least=len(resolver.results())):
        wait_until(lambda: len(beats) > LEAST_BEATS, "beats in ROS")
    assert [each.data[1] for each in beats[1:]].count(1.0) <= 1
    assert all(40 < each.data < 150 for each in rates)
    # Of the recording, which begins later, the same comes by the same code once it has learnt.
    command = [sys.executable, "-m", "biosensor_gateway.cli", "features", str(path)]
    subprocess.run([*command, "--output", str(again)], check=True, capture_output=True)
    live, offline = _by_data(path), _by_data(again)
    assert offline["beats"]["info"]["desc"][0]["features"][0]["algorithm"]
    found = dict(zip(live["beats"]["time_stamps"], live["beats"]["time_series"], strict=True))
    both = [
        (found[stamp], value)
        for stamp, value in zip(
            offline["beats"]["time_stamps"], offline["beats"]["time_series"], strict=True
        )
        if stamp in found and np.isfinite(value).all()
    ]
    assert len(both) >= 3
    assert all((one == other).all() for one, other in both)
