"""A node whose computer gives it little: arenas of malloc, a console, open files."""

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
from tests.rigs.arenas import count_arenas
from tests.rigs.terminal import HeldConsole

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode

pytestmark = pytest.mark.nightly

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
    command = [sys.executable, "-m", "lsl_to_ros.node", "--ros-args", "-p", "Chunk_Length:=0"]
    with console.program(command, os.environ) as node:
        ros.report()
        console.release()
        ros.until(lambda: "Chunk_Length must" in console.shown, "what was wrong")
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
