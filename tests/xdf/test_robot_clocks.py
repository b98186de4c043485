"""What is said of streams that ``ros_to_lsl`` made, by what it found out of the robot's clock."""

from __future__ import annotations

import json
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from biosensor_common.lsl_header import describe
from biosensor_common.naming import NODE, lsl_name, source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.recording.xdf.findings import Level
from lsl_to_ros.reports.clock_pairs import EVENTS
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes, text_of

STAMPS = [1000.0 + k / 50 for k in range(500)]
HOST = "lab"


def robot(clock: str, edge_s: float | None, stamped_by: str = "header") -> tuple[bytes, ...]:
    desc = ET.Element("desc")
    ET.SubElement(ET.SubElement(desc, "synchronization"), "can_drop_samples").text = "true"
    ros = ET.SubElement(desc, "ros")
    told = {"topic": "/pose", "stamp_source": stamped_by, "clock": clock}
    if edge_s is not None:
        told["clock_edge_s"] = f"{edge_s:.6f}"
    for name, text in told.items():
        ET.SubElement(ros, name).text = text
    return x.regular(1, "pose", STAMPS, 50.0, desc=desc, host=HOST)


def events(**clocks: Any) -> tuple[bytes, ...]:
    """One heartbeat of a node on the same computer, and what nobody can read."""
    identity = DeviceIdentity(NODE, f"{HOST}_ros_to_lsl")
    header = x.stream_header(
        2,
        lsl_name(identity, EVENTS.data_name),
        kind=EVENTS.content_type.value,
        fmt="string",
        source_id=source_id(identity, EVENTS.data_name),
        desc=describe(EVENTS, identity, DeviceInfo(model="ros_to_lsl")),
        host=HOST,
    )
    told = {"event": "heartbeat", "topics": {"/pose": {"clocks": clocks}, "/other": {}}}
    texts = [json.dumps(told), "{", "[1]", '{"topics": {"/pose": {"clocks": {"header": 1}}}}']
    values = x.samples(2, "string", [[each] for each in texts], [1001.0, 1002.0, 1003.0, 1004.0])
    return header, values, x.offsets(2, (1001.0, 1004.0)) + x.footer(2, len(texts))


@pytest.mark.parametrize(("clock", "edge_s"), [("synchronised", 0.0195), ("unknown", None)])
def test_a_clock_that_is_right_is_no_finding(clock: str, edge_s: float | None) -> None:
    assert not check(x.xdf(*robot(clock, edge_s))).findings


DOUBTS = [
    ("behind", 0.5, "may be behind by up to 0.500 s"),
    ("synchronised", 0.021, "may be behind by up to 0.021 s"),
    ("unsynchronised", None, "is not known to be right"),
    ("wrong", 0.5, "is wrong: about 0.500 s behind"),
    ("wrong", -0.005, "is 0.005 s ahead, at least"),
]


@pytest.mark.parametrize(("clock", "edge_s", "words"), DOUBTS)
def test_a_clock_that_may_be_off_is_a_warning(clock: str, edge_s: float | None, words: str) -> None:
    report = check(x.xdf(*robot(clock, edge_s, "arrival")))
    assert codes(report, Level.WARNING) == {("robot-clock", "pose")}
    text = text_of(report, "robot-clock", "pose")
    assert words in text
    assert "time of its arrival" in text


def test_what_is_found_later_stands_in_the_nodes_events() -> None:
    late = {"header": {"state": "behind", "edge_s": 0.25}}
    report = check(x.xdf(*robot("synchronised", 0.001), *events(**late)))
    assert "up to 0.250 s" in text_of(report, "robot-clock", "pose")
    right = {"header": {"state": "synchronised", "edge_s": 0.001}}
    assert not check(x.xdf(*robot("synchronised", 0.001), *events(**right))).findings
