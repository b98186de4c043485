"""A recording and the topics of one session fall onto one axis, to a millisecond."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import Imu

from biosensor_common.naming import AGENT
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.recording.contents.opening import open_contents
from biosensor_gateway.recording.contents.wall_clock import find_wall_clock
from tests.rigs.lab_recorder import LabRecorder

pytestmark = pytest.mark.nightly

# Longer than a heartbeat of the node, and the recorder's clock offsets come every 5 s.
RECORD_S = 11.0
SAME_NS = 1_000_000
# Those of the headset and of the agent, and the node's. LabRecorder looks for a second only.
STREAMS = len([*declaration("emotiv_insight").streams, *declaration(AGENT).streams]) + 1


@pytest.mark.seam
def test_wall_time_of_the_recording_is_the_stamp_of_the_topic(
    programs: Any, listener: Any, wait_until: Callable[..., None], tmp_path: Path
) -> None:
    path = tmp_path / "study.xdf"
    programs.node()
    programs.start("biosensor_gateway.cli", "run", "--simulate", "emotiv_insight")

    def topics() -> list[str]:
        names = dict(listener.node.get_topic_names_and_types())
        return [name for name in names if name.endswith("/mot_imu")]

    wait_until(topics, "a topic of the motion sensor")
    messages = listener.listen(Imu, *topics())
    wait_until(lambda: len(messages) > 10, "accelerations")
    with LabRecorder(path, at_least=STREAMS):
        time.sleep(RECORD_S)
    published = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages])
    with open_contents(path) as contents:
        wall = contents.wall
        assert wall is not None
        assert wall.source.startswith("lsl_to_ros-")
        others = [each for each in contents.streams if each.header.name != wall.source]
        by_agent = find_wall_clock(others, "", contents.begin_s)
        (motion,) = [each for each in others if each.header.data_name == "mot"]
        times = np.concatenate([each.times for each in motion.blocks()])
    recorded = wall.to_unix_ns(times)
    assert len(recorded) > 100
    after = np.clip(np.searchsorted(published, recorded), 1, len(published) - 1)
    nearest = np.minimum(
        np.abs(published[after] - recorded), np.abs(published[after - 1] - recorded)
    )
    # The last of them may not have been published when the listener was asked.
    assert nearest[: -len(recorded) // 10].max() < SAME_NS
    # Where no node runs the agent's own pairs tell the same.
    assert by_agent is not None
    assert by_agent.source.startswith(f"{AGENT}-")
    assert np.abs(by_agent.to_unix_ns(times) - recorded).max() < SAME_NS
