"""A node whose console takes no output: topics flow, and it ends."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

import pylsl
import pytest
from std_msgs.msg import Float32MultiArray

from tests.rigs.held_console import HeldConsole

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros

pytestmark = pytest.mark.nightly

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
