"""How the node starts with bad settings, and how it ends."""

from __future__ import annotations

import os
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32MultiArray

from biosensor_common.process_limits import ARENAS
from tests.faults.agent import AgentProcess
from tests.rigs.processes import count_arenas
from tests.rigs.terminal import HeldConsole

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode


pytestmark = pytest.mark.nightly

Start = Callable[..., "RunningNode"]

PARAMETERS = """
lsl_to_ros:
  ros__parameters:
    qos_overrides:
      /biosensors/exit/EEG:
        publisher:
          durability: transient_local
    processes: 4
    exit:
      Chunk_Length: 3
      EEG:
        Chunk_Enable: {}
"""


def open_stream(name: str = "exit", source_id: str = "exit id") -> pylsl.StreamOutlet:
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, 100.0, "float32", source_id))


def test_a_parameter_file_holds_and_a_bad_value_in_it_ends_the_node(
    ros: Ros, start_node: Start, tmp_path: Path
) -> None:
    bad, good = tmp_path / "bad.yaml", tmp_path / "good.yaml"
    bad.write_text(PARAMETERS.format("7"))
    good.write_text(PARAMETERS.format("true"))
    refused = start_node("--ros-args", "--params-file", str(bad))
    assert refused.wait() == 2
    assert refused.count("lsl_to_ros: exit.EEG.Chunk_Enable must be true or false, not 7") == 1
    node = start_node("--ros-args", "--params-file", str(good))
    outlet = open_stream()
    raw = ros.listen(Float32MultiArray, "/biosensors/exit/EEG")
    chunks = ros.listen(Float32MultiArray, "/biosensors/exit/EEG_chunk")
    ros.attached("/biosensors/exit/EEG", readers=2)
    start = pylsl.local_clock()
    outlet.push_chunk([[0.0], [1.0], [2.0]], [start + number * 0.01 for number in range(3)])
    ros.until(lambda: len(raw) == 3 and len(chunks) == 1, "three samples and a chunk")
    assert list(chunks[0].data) == [0.0, 1.0, 2.0]
    assert node.count("[ERROR]", "processes is no longer a parameter", "ignored") == 1
    for topic, durability in (("EEG", "TRANSIENT_LOCAL"), ("EEG_chunk", "VOLATILE")):
        (publisher,) = ros.publishers(f"/biosensors/exit/{topic}")
        assert publisher.qos_profile.reliability.name == "RELIABLE"
        assert publisher.qos_profile.durability.name == durability
    assert node.signal(signal.SIGINT) == 0
    assert "Traceback" not in node.log


@pytest.mark.seam
def test_what_is_wrong_ends_it_and_help_is_help(start_node: Start) -> None:
    wrong = {
        "-p must come after --ros-args": ("-p", "Chunk_Length:=5"),
        "there is no argument --simulate": ("--simulate",),
        "stream_predicate must be an LSL query": ("--ros-args", "-p", "stream_predicate:=type="),
        "sesion_id is not a parameter": ("--ros-args", "-p", "sesion_id:=lab"),
        "known_peers must be a list": ("--ros-args", "-p", "known_peers:=robot.local"),
        "Chunk_Length must be an integer": ("--ros-args", "-p", "Chunk_Length:=-4"),
        "Chunk_Lenght is not a parameter of this node; Chunk_Length is": (
            "--ros-args",
            "-p",
            "Chunk_Lenght:=4",
        ),
        "a parameter has no value": ("--ros-args", "-p", "topic_prefix:=[]"),
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


# A node whose computer gives it little: arenas of malloc, a console, open files.

# Node and agent keep to few arenas of malloc, however many threads they have.

# Threads that the agent begins before, for its console and its log, keep theirs.
BEFORE_AGENT = 7


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's arenas")
def test_the_node_has_few_arenas(ros: Ros, start_node: Callable[..., RunningNode]) -> None:
    node = start_node()
    names = [f"arena{place}" for place in range(16)]
    outlets = [
        pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, 100.0, "float32", name))
        for name in names
    ]
    ros.attached(*(f"/biosensors/{name}/EEG" for name in names))
    for outlet in outlets:
        outlet.push_sample([1.0])
    ros.until(lambda: bool(ros.status("/biosensors/arena15/EEG")), "what the node says of it")
    print(f"{count_arenas(node.pid)} arenas")
    assert count_arenas(node.pid) == ARENAS


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's arenas")
def test_the_agent_has_few_arenas(tmp_path: Path) -> None:
    with AgentProcess(tmp_path, "--simulate", "zephyr", environment={}) as agent:
        streams = pylsl.resolve_byprop("type", "ECG", timeout=30.0)
        print(f"{count_arenas(agent.pid)} arenas")
        assert count_arenas(agent.pid) <= ARENAS + BEFORE_AGENT
    assert streams


# A node whose console takes no output: topics flow, and it ends.
DEADLINE_S, RATE = 30.0, 100.0
# ROS itself says more in a second than a terminal keeps.
COMMAND = [sys.executable, "-m", "lsl_to_ros.node", "--ros-args", "--log-level", "debug"]


@pytest.mark.parametrize("is_stopped", [False, True], ids=["nobody reads", "Ctrl-S"])
def test_topics_flow_while_the_console_is_held(
    ros: Ros, flow: Callable[..., Flow], is_stopped: bool
) -> None:
    console = HeldConsole(is_stopped=is_stopped)
    name = f"held_{'stopped' if is_stopped else 'unread'}"
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, RATE, "float32", name))
    with console.program(COMMAND, os.environ) as node:
        heard = ros.listen(Float32MultiArray, f"/biosensors/{name}/EEG")
        ros.until(lambda: not console.takes_output, "a console that takes nothing")
        ros.attached(f"/biosensors/{name}/EEG", readers=1)
        pushing = flow(outlet, RATE)
        ros.until(lambda: len(heard) >= 3 * RATE, "300 samples")
        total = pushing.stop()
        ros.until(lambda: len(heard) == total, "all samples")
        assert [message.data[0] for message in heard] == list(range(1, total + 1))
        node.send_signal(signal.SIGINT)
        assert node.wait(DEADLINE_S) == 0
        assert not console.takes_output


def test_a_released_console_shows_what_was_said_meanwhile_in_its_colours(ros: Ros) -> None:
    console = HeldConsole(is_stopped=True)
    command = [sys.executable, "-m", "lsl_to_ros.node", "--ros-args", "-p", "processes:=2"]
    with console.program(command, os.environ) as node:
        ros.report()
        console.release()
        ros.until(lambda: "processes is no longer" in console.shown, "what was wrong")
        node.send_signal(signal.SIGINT)
        assert node.wait(DEADLINE_S) == 0
    assert "\x1b[31m" in console.shown
    assert "Traceback" not in console.shown


# A node that may open too few files names the streams that it leaves out, until they fit.
# Enough for ROS and some streams, too few for all of them.
FILES, STREAMS = 256, 20


def outlet(number: int) -> pylsl.StreamOutlet:
    info = pylsl.StreamInfo(f"crowd{number}", "EEG", 1, 0.0, "float32", f"crowd id {number}")
    return pylsl.StreamOutlet(info)


def test_streams_that_do_not_fit_are_named_until_others_have_gone(
    ros: Ros, start_node: Callable[..., RunningNode]
) -> None:
    node = start_node()
    resource.prlimit(node.pid, resource.RLIMIT_NOFILE, (FILES, FILES))
    outlets = [outlet(number) for number in range(STREAMS)]

    def crowded_out() -> int:
        status = ros.status("node")
        if status is None or "streams_left_out" not in status.values:
            return 0
        return int(status["streams_left_out"])

    def served() -> int:
        return sum(topic.startswith("/biosensors/crowd") for topic in ros.present())

    ros.until(lambda: crowded_out() > 0 and crowded_out() + served() == STREAMS, "some do not fit")
    status = ros.status("node")
    assert status is not None
    assert status.level == DiagnosticStatus.WARN
    assert f"{crowded_out()} streams are left out (crowd" in status.message
    assert f"lets a program open {FILES} files" in status.message
    assert "prlimit" in status.message
    assert node.count("is left out") == crowded_out()
    del outlets[: STREAMS // 2]
    ros.until(lambda: served() == STREAMS // 2 and crowded_out() == 0, "the others fit")
    status = ros.status("node")
    assert status is not None
    assert "left out" not in status.message
