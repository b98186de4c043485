"""How the node starts with bad settings, and how it ends."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pylsl
import pytest
from std_msgs.msg import Float32MultiArray

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

Start = Callable[..., "RunningNode"]

PARAMETERS = """
lsl_to_ros:
  ros__parameters:
    Chunk_Length: 0
    Chunk_Enabled: true
    topic_prefix: /absolute
    qos_overrides:
      /biosensors/exit/EEG:
        publisher:
          reliability: sometimes
          durability: transient_local
      /biosensors/exit/EEG_chunk:
        publisher:
          depth: 0
      /diagnostics:
        publisher:
          lifespan: 5
    exit:
      Sensor_Enable: "yes"
      Chunk_Length: 3
      EEG:
        Chunk_Enable: 7
"""

BAD = (
    "Chunk_Length must",
    "Chunk_Enabled",
    "exit.Sensor_Enable",
    "exit.EEG.Chunk_En",
    "topic_prefix must",
    "EEG.publisher.reliability must be one of",
    "EEG_chunk.publisher.depth must be",
    "diagnostics.publisher.lifespan",
)


def open_stream(name: str = "exit", source_id: str = "exit id") -> pylsl.StreamOutlet:
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, 100.0, "float32", source_id))


def test_bad_values_of_a_parameter_file_are_said_and_ignored(
    ros: Ros, start_node: Start, tmp_path: Path
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(PARAMETERS)
    node = start_node("--ros-args", "--params-file", str(file))
    outlet = open_stream()
    raw = ros.listen(Float32MultiArray, "/biosensors/exit/EEG")
    chunks = ros.listen(Float32MultiArray, "/biosensors/exit/EEG_chunk")
    ros.attached("/biosensors/exit/EEG", readers=2)
    start = pylsl.local_clock()
    outlet.push_chunk([[0.0], [1.0], [2.0]], [start + number * 0.01 for number in range(3)])
    ros.until(lambda: len(raw) == 3 and len(chunks) == 1, "three samples and a chunk")
    assert list(chunks[0].data) == [0.0, 1.0, 2.0]
    for name in BAD:
        assert node.count("[ERROR]", name, "ignored") == 1
    assert node.count("[ERROR]") == len(BAD)
    for topic, durability in (("EEG", "TRANSIENT_LOCAL"), ("EEG_chunk", "VOLATILE")):
        (publisher,) = ros.publishers(f"/biosensors/exit/{topic}")
        assert publisher.qos_profile.reliability.name == "RELIABLE"
        assert publisher.qos_profile.durability.name == durability
    assert node.signal(signal.SIGINT) == 0
    assert "Traceback" not in node.log


@pytest.mark.seam
def test_what_is_wrong_ends_it_and_help_is_help(start_node: Start) -> None:
    wrong = {
        "-p must stand behind --ros-args": ("-p", "Chunk_Length:=5"),
        "there is no argument --simulate": ("--simulate",),
        "stream_predicate must be an LSL query": ("--ros-args", "-p", "stream_predicate:=type="),
        "sesion_id is no parameter": ("--ros-args", "-p", "sesion_id:=lab"),
        "known_peers must be a list": ("--ros-args", "-p", "known_peers:=robot.local"),
    }
    nodes = {words: start_node(*arguments) for words, arguments in wrong.items()}
    shown = start_node("--help")
    for words, node in nodes.items():
        assert node.wait() == 2
        assert node.count(f"lsl_to_ros: {words}") == 1
        assert "Traceback" not in node.log
    assert shown.wait() == 0
    assert "stream_predicate" in shown.log


@pytest.mark.seam
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_node_cleanly_while_samples_flow(
    ros: Ros, start_node: Start, number: signal.Signals
) -> None:
    node = start_node()
    outlets = [open_stream(f"flow {n}", f"flow {n}") for n in range(8)]
    heard = ros.listen(Float32MultiArray, "/biosensors/flow_x207/EEG")
    pushed = 0

    def push() -> bool:
        nonlocal pushed
        pushed += 1
        for outlet in outlets:
            outlet.push_sample([float(pushed)], pylsl.local_clock())
        return len(heard) >= 20

    ros.until(push, "twenty samples")
    assert node.signal(number) == 0
    assert "Traceback" not in node.log
    assert "rror" not in node.log


def test_a_signal_ends_the_node_cleanly_while_streams_come_and_go(
    ros: Ros, start_node: Start
) -> None:
    node = start_node()
    outlets = [open_stream(f"gone {n}", f"gone {n}") for n in range(8)]
    ros.attached(*(f"/biosensors/gone_x20{n}/EEG" for n in range(8)))
    outlets.clear()
    coming = [open_stream(f"come {n}", f"come {n}") for n in range(8)]
    ros.until(lambda: node.count("is gone") > 0, "a stream that is gone")
    assert node.signal(signal.SIGTERM) == 0
    assert "Traceback" not in node.log
    del coming
