"""The node on three processes: to users it is one."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces import srv
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float32MultiArray

from lsl_to_ros.lsl.share import Share

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode

PROCESSES = 3
NODE_ARGUMENTS = ("--ros-args", "-p", f"processes:={PROCESSES}")
STREAMS, RATE_HZ = 12, 100.0
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]


def info(name: str, source_id: str = "") -> pylsl.StreamInfo:
    source_id = source_id or f"id of {name}"
    return pylsl.StreamInfo(name, "EEG", 1, RATE_HZ, "float32", source_id)


def topic_of(name: str) -> str:
    return f"/biosensors/{name}/EEG"


def for_process(index: int, words: str) -> str:
    """The first of some words that is the source_id of a stream of that process."""
    share = Share(index, PROCESSES)
    return next(
        word for word in (f"{words}{n}" for n in range(1000)) if share.has(info("any", word))
    )


@pytest.mark.seam
def test_every_stream_comes_once_and_all_is_told_as_of_one_node(
    ros: Ros, flow: Callable[..., Flow]
) -> None:
    names = [f"once{number}" for number in range(STREAMS)]
    topics = [topic_of(name) for name in names]
    heard = [ros.listen(Float32MultiArray, topic) for topic in topics]
    lists = ros.listen(DiagnosticArray, "/lsl_to_ros/streams", LATCHED)
    outlets = [pylsl.StreamOutlet(info(name)) for name in names]
    ros.attached(*topics, readers=1)
    flows = [flow(each, RATE_HZ) for each in outlets]
    ros.until(lambda: min(map(len, heard)) > 200, "two seconds of samples")
    pushed = [each.stop() for each in flows]
    ros.until(lambda: [len(messages) for messages in heard] == pushed, "all samples")
    ros.report()
    for messages, count in zip(heard, pushed, strict=True):
        assert [message.data[0] for message in messages] == list(range(1, count + 1))
    assert [entry.name for entry in lists[-1].status] == sorted(topics)
    node = ros.status("node")
    assert node is not None
    assert (node["streams"], node["processes"]) == (str(STREAMS), str(PROCESSES))
    shares = [ros.status(f"process {index}") for index in range(PROCESSES)]
    assert all(each is not None and int(each["streams"]) > 0 for each in shares)


def test_the_graph_has_one_node_with_services_and_one_diagnostics(ros: Ros) -> None:
    names = [f"graph{number}" for number in range(STREAMS)]
    outlets = [pylsl.StreamOutlet(info(name)) for name in names]
    ros.attached(*map(topic_of, names))
    publishers = [ros.publishers(topic_of(name)) for name in names]
    assert all(len(each) == 1 for each in publishers)
    assert {each[0].node_name for each in publishers} == {
        "lsl_to_ros",
        "_lsl_to_ros_1",
        "_lsl_to_ros_2",
    }
    # Topics may be discovered before services.
    service = "/lsl_to_ros/set_parameters"
    ros.until(lambda: service in ros.services("lsl_to_ros"), "the services are known")
    assert not ros.services("_lsl_to_ros_1")
    for topic in ("/diagnostics", "/lsl_to_ros/streams"):
        (publisher,) = ros.publishers(topic)
        assert publisher.node_name == "lsl_to_ros"
    del outlets


def test_units_of_one_name_are_named_apart_whoever_reads_them(ros: Ros) -> None:
    units = [for_process(index, "unit") for index in range(PROCESSES)]
    outlets = [pylsl.StreamOutlet(info("same", units[0]))]
    ros.attached("/biosensors/same/EEG")
    plain = ros.listen(Float32MultiArray, "/biosensors/same/EEG")
    ros.attached("/biosensors/same/EEG", readers=1)
    outlets += [pylsl.StreamOutlet(info("same", unit)) for unit in units[1:]]
    named = [f"/biosensors/same_{unit}/EEG" for unit in units]
    heard = [ros.listen(Float32MultiArray, topic) for topic in named]
    ros.attached(*named, readers=1)
    ros.until(lambda: not ros.publishers("/biosensors/same/EEG"), "the plain name is closed")
    for outlet, value in zip(outlets, (1.0, 2.0, 3.0), strict=True):
        outlet.push_sample([value])
    ros.until(lambda: all(heard), "a sample of each")
    assert [messages[0].data[0] for messages in heard] == [1.0, 2.0, 3.0]
    assert plain == []
    for name in named:
        status = ros.status(name)
        assert status is not None
        assert status.level == DiagnosticStatus.ERROR


def test_a_parameter_that_is_set_holds_in_every_process(ros: Ros, node: RunningNode) -> None:
    sources = [for_process(index, "set") for index in range(PROCESSES)]
    topics = [topic_of(source) for source in sources]
    outlets = [pylsl.StreamOutlet(info(source, source)) for source in sources]
    heard = [ros.listen(Float32MultiArray, topic) for topic in topics]
    chunks = [ros.listen(Float32MultiArray, f"{topic}_chunk") for topic in topics]
    ros.attached(*topics, readers=2)
    assert set(parameters(ros)) >= {f"{source}.EEG.Chunk_Length" for source in sources}
    assert "out of range" in ros.set("Chunk_Length", 0)
    assert ros.set("Chunk_Length", 2) == ""
    assert ros.set(f"{sources[2]}.EEG.Chunk_Length", 3) == ""
    pushed = 0

    def push() -> None:
        nonlocal pushed
        for outlet in outlets:
            outlet.push_chunk([[float(pushed + number)] for number in range(6)])
        pushed += 6

    def are_set() -> bool:
        # The other processes are told a little later.
        push()
        ros.spin(0.2)
        return [len(each[-1].data) if each else 0 for each in chunks] == [2, 2, 3]

    ros.until(are_set, "chunks of 2, 2 and 3")
    first = pushed
    push()

    def new() -> list[list[int]]:
        """The lengths of the chunks that were full since, of each stream."""
        return [[len(each.data) for each in part if each.data[-1] >= first] for part in chunks]

    ros.until(lambda: new() == [[2] * 3, [2] * 3, [3] * 2], "chunks of the new lengths alone")
    ros.until(lambda: [len(each) for each in heard] == [pushed] * PROCESSES, "all samples")
    assert ros.set(f"{sources[2]}.EEG.Chunk_Length", None) == ""
    assert ros.set("Sensor_Enable", False) == ""

    def brings_nothing() -> bool:
        before = [len(each) for each in heard]
        push()
        ros.spin(0.5)
        return [len(each) for each in heard] == before

    ros.until(brings_nothing, "that no process publishes")
    assert brings_nothing()
    assert ros.set("Sensor_Enable", True) == ""
    assert ros.set("Chunk_Length", 128) == ""
    assert ros.set("processes", 2) != ""
    # Of a stream of any process it is known, and of a misspelt one it is not.
    assert ros.set("mispselt.EEG.Chunk_Length", 3) == ""
    early = "holds for no stream yet"
    ros.until(lambda: node.count("mispselt.EEG.Chunk_Length", early) == 1, "a line in the log")
    assert node.count(f"{sources[2]}.EEG.Chunk_Length", early) == 0


def parameters(ros: Ros) -> list[str]:
    kind: type[Any] = vars(srv)["ListParameters"]
    return ros.call("/lsl_to_ros/list_parameters", kind, kind.Request()).result.names


def test_a_prefix_moves_the_topics_of_every_process(ros: Ros) -> None:
    sources = [for_process(index, "moved") for index in range(PROCESSES)]
    outlets = [pylsl.StreamOutlet(info(source, source)) for source in sources]
    ros.attached(*map(topic_of, sources))
    assert ros.set("topic_prefix", "elsewhere") == ""
    ros.attached(*(f"/elsewhere/{source}/EEG" for source in sources))
    assert ros.set("topic_prefix", "biosensors") == ""
    ros.attached(*map(topic_of, sources))
    del outlets
