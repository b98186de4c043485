"""``topic_prefix`` and ``stream_predicate``, changed while samples flow."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float32MultiArray

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

Begin = Callable[..., "Flow"]

RATE = 100.0
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


# Stays until its input ends.
ANOTHER_PROGRAM = """
import sys, pylsl
outlet = pylsl.StreamOutlet(pylsl.StreamInfo("another_lab", "ECG", 1, 0.0, "float32", "x"))
print("open", flush=True)
sys.stdin.read()
"""


def foreign(name: str, kind: str = "EEG") -> pylsl.StreamOutlet:
    info = pylsl.StreamInfo(name, kind, 1, RATE, "float32", f"id of {name}")
    return pylsl.StreamOutlet(info)


def numbers(messages: list[Any]) -> list[float]:
    return [value for message in messages for value in message.data]


def is_unbroken(values: list[float]) -> bool:
    return values == [values[0] + place for place in range(len(values))]


@pytest.fixture(autouse=True)
def defaults(ros: Ros) -> Iterator[None]:
    yield
    assert ros.set("stream_predicate", "") == ""
    assert ros.set("topic_prefix", "biosensors") == ""


def test_a_change_of_prefix_moves_every_topic_while_samples_go_on(ros: Ros, flow: Begin) -> None:
    assert ros.set("moving.Chunk_Length", 10) == ""
    outlet = foreign("moving")
    ros.attached("/biosensors/moving/EEG")
    flowing = flow(outlet, RATE)
    raw: list[float] = []
    chunked: list[float] = []
    before = "biosensors"
    for prefix in ("lab/bio_2", "", "biosensors"):
        old, new = (f"/{part}/moving/EEG".replace("//", "/") for part in (before, prefix))
        heard = {
            topic: ros.listen(Float32MultiArray, topic)
            for topic in (old, f"{old}_chunk", new, f"{new}_chunk")
        }
        ros.until(lambda heard=heard, old=old: bool(heard[old]), f"samples on {old}")
        assert ros.set("topic_prefix", prefix) == ""
        ros.until(
            lambda heard=heard, new=new: min(len(heard[new]), len(heard[f"{new}_chunk"])) > 2,
            f"samples and chunks on {new}",
        )
        ros.until(
            lambda old=old: not ros.publishers(old) and not ros.publishers(f"{old}_chunk"),
            f"the end of {old}",
        )
        ros.stop_listening()
        parts = [numbers(heard[topic]) for topic in (old, new)]
        assert all(is_unbroken(part) for part in parts)
        # Nothing comes twice, neither on one topic nor on both.
        assert parts[0][-1] < parts[1][0]
        assert not raw or raw[-1] < parts[0][0]
        raw += [*parts[0], *parts[1]]
        chunked += [*numbers(heard[f"{old}_chunk"]), *numbers(heard[f"{new}_chunk"])]
        before = prefix
    assert sorted(set(raw)) == raw
    assert sorted(set(chunked)) == chunked
    total = flowing.stop()
    topic = "/biosensors/moving/EEG"

    def all_were_received() -> bool:
        status = ros.status(topic)
        return status is not None and status["received"] == str(total)

    ros.until(all_were_received, "every sample at the node")
    status = ros.status(topic)
    assert status is not None
    # Of each move, less than a chunk.
    assert int(status["chunk_discarded"]) <= 3 * 9
    assert status["lost"] == "about 0"
    assert ros.present() >= {topic}


@pytest.mark.parametrize(
    "prefix", ["/abs", "a b", "1a", "a//b", "a/", "a__b", "under_", "x" * 200, "~a", "{node}", "é"]
)
def test_a_bad_prefix_is_refused_with_its_name(ros: Ros, prefix: str) -> None:
    reason = ros.set("topic_prefix", prefix)
    assert reason.startswith("topic_prefix must be")
    assert repr(prefix) in reason


def test_what_no_longer_fits_is_detached_and_the_rest_loses_nothing(ros: Ros, flow: Begin) -> None:
    kinds = ("EEG", "ECG", "PPG")
    topics = {kind: f"/biosensors/chosen/{kind}" for kind in kinds}
    heard = {kind: ros.listen(Float32MultiArray, topics[kind]) for kind in kinds}
    outlets = {kind: foreign("chosen", kind) for kind in kinds}
    ros.attached(*topics.values(), readers=1)
    flows = {kind: flow(outlets[kind], RATE) for kind in kinds}
    ros.until(lambda: all(heard.values()), "samples of each")

    def chosen() -> set[str]:
        return {kind for kind in kinds if topics[kind] in ros.present()}

    for predicate, expected in (
        ("type='EEG' or type='ECG'", {"EEG", "ECG"}),
        ("type='EEG'", {"EEG"}),
        ("name='chosen' and not(type='PPG')", {"EEG", "ECG"}),
        ("", set(kinds)),
    ):
        assert ros.set("stream_predicate", predicate) == ""
        ros.until(lambda expected=expected: chosen() == expected, f"{expected} alone")
    # The report that PPG is back may come before its first sample.
    ros.until(lambda: not is_unbroken(numbers(heard["PPG"])), "PPG again, behind a hole")
    numbered = {kind: numbers(heard[kind]) for kind in kinds}
    for kind in kinds:
        assert sorted(set(numbered[kind])) == numbered[kind]
    total = flows["EEG"].stop()
    ros.until(lambda: len(heard["EEG"]) >= total, "every sample of the stream that stayed")
    assert numbers(heard["EEG"]) == list(range(1, total + 1))
    ros.report()
    status = ros.status(topics["EEG"])
    assert status is not None
    assert (status["received"], status["lost"]) == (str(total), "about 0")


@pytest.mark.parametrize(
    "predicate",
    ["type=", "type='EEG", "[[", "starts-with(name)", "type='EEG') or (type='ECG'", "EEG)"],
)
def test_what_is_no_query_is_refused_with_the_name_and_an_example(ros: Ros, predicate: str) -> None:
    reason = ros.set("stream_predicate", predicate)
    assert reason.startswith("stream_predicate must be an LSL query such as type='EEG'")
    assert repr(predicate) in reason


@pytest.fixture
def other_session(tmp_path: Path) -> Iterator[None]:
    """Open an ECG stream in another LSL session of this machine."""
    file = tmp_path / "lsl_api.cfg"
    config = Path(os.environ["LSLAPICFG"]).read_text()
    file.write_text(re.sub("SessionID = .*", "SessionID = another", config))
    with subprocess.Popen(
        [sys.executable, "-c", ANOTHER_PROGRAM],
        env={**os.environ, "LSLAPICFG": str(file)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "open\n"
        yield


@pytest.mark.seam
@pytest.mark.usefixtures("other_session")
def test_two_nodes_share_the_streams_of_their_session_without_overlap(
    ros: Ros, start_node: Callable[..., RunningNode], flow: Begin
) -> None:
    # The module's own node must not take part.
    assert ros.set("stream_predicate", "false()") == ""
    kinds = ("EEG", "ECG", "PPG", "GSR")
    topics = [f"/biosensors/shared/{kind}" for kind in kinds]
    elsewhere = "/biosensors/another_lab/ECG"
    outlets = [foreign("shared", kind) for kind in kinds]
    ros.until(lambda: not set(topics) & ros.present(), "a node without streams")
    # liblsl puts its condition on the session before the query, and this one has an "or".
    predicates = {"shard_a": "type='EEG' or type='ECG'"}
    predicates["shard_b"] = f"not({predicates['shard_a']})"
    for name, predicate in predicates.items():
        rename, query = f"__node:={name}", f'stream_predicate:="{predicate}"'
        start_node("--ros-args", "-r", rename, "-p", query)
    lists = {name: ros.listen(DiagnosticArray, f"/{name}/streams", LATCHED) for name in predicates}
    heard = [ros.listen(Float32MultiArray, topic) for topic in topics]

    def served(name: str) -> set[str]:
        if not lists[name]:
            return set()
        return {*topics, elsewhere} & {status.name for status in lists[name][-1].status}

    ros.until(lambda: served("shard_a") | served("shard_b") >= set(topics), "all four streams")
    flows = [flow(outlet, RATE) for outlet in outlets]
    ros.until(lambda: all(len(messages) > 50 for messages in heard), "samples of each")
    totals = [one.stop() for one in flows]
    ros.until(
        lambda: all(
            messages[-1].data[0] == total for messages, total in zip(heard, totals, strict=True)
        ),
        "the last sample of each",
    )
    assert all(is_unbroken(numbers(messages)) for messages in heard)
    assert served("shard_a") == set(topics[:2])
    assert served("shard_b") == set(topics[2:])
    for topic in topics:
        (publisher,) = ros.publishers(topic)
        owner = "shard_a" if topic in topics[:2] else "shard_b"
        assert publisher.node_name == owner


def test_a_topic_that_would_be_too_long_for_ros_harms_no_other_stream(
    ros: Ros, node: RunningNode, flow: Begin
) -> None:
    data = "d" * 60
    stream = replace(declaration("polar_h10").stream("ecg"), data_name=data, chunk=data)
    place = DeviceIdentity("polar_h10", "U1", participant="p" * 64, label="l" * 60)
    long = Outlet(stream, place, DeviceInfo())
    flow(foreign("short"), RATE)
    ros.until(lambda: len(ros.present() & {"/biosensors/short/EEG"}) == 1, "the short one")
    ros.until(lambda: any(data in topic for topic in ros.present()), "the long one")
    prefix = "x" * 100
    ros.set("topic_prefix", prefix)
    heard = ros.listen(Float32MultiArray, f"/{prefix}/short/EEG")
    stayed = ros.listen(Float32MultiArray, "/biosensors/short/EEG")
    # Either the prefix is refused, or all but the long one move.
    ros.until(lambda: bool(heard or stayed), "samples of the short one")
    assert node.is_running
    del long
