"""A node that may open too few files names the streams that it leaves out, until they fit."""

from __future__ import annotations

import resource
from collections.abc import Callable
from typing import TYPE_CHECKING

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

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
