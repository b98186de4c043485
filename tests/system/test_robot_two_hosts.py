"""A robot and ``ros_to_lsl`` on one computer, LabRecorder on another one.

Their LSL clocks are hours apart, and LSL alone tells the recorder how far.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
import pyxdf

from biosensor_common.ros_clock import NS_PER_S
from tests.rigs.hosts.lan import Lan
from tests.rigs.hosts.programs import Program
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.recorded_robot import (
    UNWRITTEN_S,
    Stream,
    greatest_errors_s,
    told_lost,
)
from tests.rigs.robot import PARTS

pytestmark = [pytest.mark.system, pytest.mark.timeout(200)]

RECORDER_AHEAD_S = 3_600
# LabRecorder asks for the clocks' offset every five seconds.
RECORD_S = 8.0
STAMP_LIMIT_S = 0.002
# The node's events are a stream, too.
STREAMS = len(PARTS) + 1
_load_xdf: Callable[..., tuple[list[Stream], Stream]] = cast("Any", pyxdf).load_xdf


@pytest.mark.alone
def test_stamps_are_those_that_were_published_on_the_other_computer(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    config = tmp_path / "lsl_api.cfg"
    config.write_text("[lab]\nSessionID = robot-two-hosts\n")
    environment = {
        **os.environ,
        "LSLAPICFG": str(config),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    }
    sent, study = tmp_path / "sent.json", tmp_path / "study.xdf"
    topics = ("-p", f"topics:=[{', '.join(each.topic for each in PARTS)}]")
    with Lan({"robot": 0, "lab": RECORDER_AHEAD_S}) as lan:
        robot = lan["robot"]
        node = Program(
            robot, environment, tmp_path, "lsl_to_ros.ros_to_lsl.node", "--ros-args", *topics
        )
        with (
            node,
            Program(robot, environment, tmp_path, "tests.rigs.robot", str(sent)),
            LabRecorder(study, at_least=STREAMS, computer=lan["lab"], environment=environment),
        ):
            begun_ns = time.time_ns()
            time.sleep(RECORD_S)
            ended_ns = time.time_ns()
    # The recording's clock is the monotonic one of the recorder's computer.
    offset_s = time.time() - (time.monotonic() + RECORDER_AHEAD_S)
    streams, _ = _load_xdf(str(study))
    by_name = {each["info"]["name"][0]: each for each in streams}
    span = begun_ns, ended_ns - round(UNWRITTEN_S * NS_PER_S)
    published = json.loads(sent.read_text())
    worst_s = greatest_errors_s(by_name, published, span, offset_s, told_lost(node.log))
    record_property("stamp error in us", {t: round(s * 1e6) for t, s in worst_s.items()})
    assert max(worst_s.values()) < STAMP_LIMIT_S, worst_s
