"""A robot's topics, sent by ``ros_to_lsl``, beside seven sensors in one file of LabRecorder."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pylsl
import pytest
import pyxdf
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from biosensor_common.naming import NODE
from biosensor_common.ros_clock import NS_PER_S, read_clock_pair
from tests.faults.scenarios.figures import is_long
from tests.rigs.lab_client import LabProcess, settings_toml
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.polling import wait_until
from tests.rigs.robot import (
    JOINTS,
    MAY_LOSE,
    PARTS,
    UNWRITTEN_S,
    Stream,
    description,
    greatest_errors_s,
    labels,
    told_lost,
)
from tests.rigs.turns import OF_A_LAB

pytestmark = pytest.mark.nightly

RECORD_S = 60.0 if is_long() else 15.0
STAMP_LIMIT_S = 0.001
ROBOT = ("joint_states", "odom", "wrench", "robot-event", "trial")
MARKER = "trial 1 begins"

_load_xdf: Callable[..., tuple[list[Stream], Stream]] = cast("Any", pyxdf).load_xdf


def _texts(stream: Stream) -> list[str]:
    return [text for (text,) in stream["time_series"]]


@pytest.fixture
def lab(tmp_path: Path) -> Any:
    devices = [
        {"key": name, "sensor": name, "options": {"seed": number}}
        for number, name in enumerate(OF_A_LAB)
    ]
    with LabProcess(devices, tmp_path) as running:
        yield running


def test_a_robot_stands_beside_the_sensors_in_one_recording(
    lab: LabProcess,
    programs: Any,
    listener: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in lab.environment.items():
        monkeypatch.setenv(name, value)
    programs.agent(settings_toml(lab, {name: name for name in OF_A_LAB}))
    topics = ", ".join([*(each.topic for each in PARTS), "/trial"])
    node = programs.start(
        "lsl_to_ros.ros_to_lsl.node",
        "--ros-args",
        *("-p", f"topics:=[{topics}]"),
        *("-p", "/trial.as:=markers"),
    )
    sent = tmp_path / "sent.json"
    robot = programs.start("tests.rigs.robot", str(sent))

    resolver = pylsl.ContinuousResolver()
    wanted = {*OF_A_LAB, *ROBOT}

    def are_there() -> bool:
        names = [info.name() for info in resolver.results()]
        return all(any(name.startswith(each) for name in names) for each in wanted)

    wait_until(are_there, "streams of seven sensors and of a robot", 90.0)
    trial = listener.node.create_publisher(String, "/trial", QoSProfile(depth=1))
    wait_until(trial.get_subscription_count, "a subscriber of /trial")
    with LabRecorder(tmp_path / "study.xdf", at_least=len(resolver.results())):
        begun_ns = time.time_ns()
        time.sleep(RECORD_S / 2)
        before_s = time.time()
        trial.publish(String(data=MARKER))
        marked_s = before_s, time.time()
        time.sleep(RECORD_S / 2)
        ended_ns = time.time_ns()
    programs.interrupt(robot)
    published: dict[str, list[int]] = json.loads(sent.read_text())

    # All programs are on one computer: offsets that were measured between them are noise.
    streams, _ = _load_xdf(str(tmp_path / "study.xdf"), synchronize_clocks=False)
    by_name = {each["info"]["name"][0]: each for each in streams}
    (events,) = (by_name[name] for name in by_name if name.startswith(f"{NODE}-"))
    offset_s = _wall_clock_offset_s(events)
    span = begun_ns, ended_ns - round(UNWRITTEN_S * NS_PER_S)
    lost = told_lost(programs.log(node))
    worst_s = greatest_errors_s(by_name, published, span, offset_s, lost)
    print({topic: f"{error_s * 1e6:.0f} us" for topic, error_s in worst_s.items()})
    assert max(worst_s.values()) < STAMP_LIMIT_S, worst_s
    steps = [int(text.split()[1]) for text in _texts(by_name["robot-event"]) if "step" in text]
    assert len(steps) >= RECORD_S
    assert np.diff(steps).tolist() == [1] * (len(steps) - 1)

    joints = by_name["joint_states"]
    measures = ("position", "velocity")
    assert labels(joints) == [f"{joint}.{each}" for each in measures for joint in JOINTS]
    assert description(joints, "ros")["stamp_source"] == ["header"]
    assert description(joints, "ros")["clock"] == ["synchronised"]
    assert description(by_name["odom"], "ros")["child_frame_id"] == ["base_link"]

    at_s = by_name["trial"]["time_stamps"][_texts(by_name["trial"]).index(MARKER)]
    assert marked_s[0] - 0.01 < at_s + offset_s < marked_s[1] + 0.01
    # One that LabRecorder has not ended has no footer.
    assert all(each["footer"] for each in streams)
    heartbeats = [json.loads(text) for text in _texts(events) if "heartbeat" in text]
    first, last = heartbeats[0]["topics"], heartbeats[-1]["topics"]
    for topic, each in last.items():
        # While all these programs start, and after the last one, more may have been lost.
        assert each["lost"] <= lost[topic]
        assert topic in MAY_LOSE or each["lost"] == first[topic]["lost"], topic
    recorded = [name for name, each in by_name.items() if len(each["time_stamps"])]
    assert all(any(name.startswith(each) for name in recorded) for each in wanted)


def _wall_clock_offset_s(events: Stream) -> float:
    """Return wall clock less LSL clock, as the node's own events tell it."""
    pairs = [read_clock_pair(json.loads(text)) for text in _texts(events)]
    return next(pair.unix_ns / 1e9 - pair.lsl_s for pair in pairs if pair is not None)
