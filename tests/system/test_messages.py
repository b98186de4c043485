"""Messages as colcon has built them: ours, and those of somebody's own package."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree as ET

import pylsl
import pytest

from tests.system.programs import Program
from tests.system.toolchain import ROOT, Toolchain
from tests.system.tracks import NS_PER_S, system_minus_lsl_ns
from tests.system.workspace import Workspace

pytestmark = pytest.mark.system

# The messages of `biosensor_msgs`, as colcon has built them.

SOURCES = ROOT / "ros_side" / "biosensor_msgs" / "msg"
# Fields in their order, types as in the .msg files. A subscriber elsewhere depends on them.
MESSAGES = {
    "Event": [("std_msgs/Header", "header"), ("uint64", "sequence"), ("string", "data")],
    "Samples": [
        ("std_msgs/Header", "header"),
        ("uint64", "sequence"),
        ("int64", "lost"),
        ("bool", "lost_is_estimated"),
        ("string[]", "labels"),
        ("string[]", "units"),
        ("int64[]", "offsets_ns"),
        ("float64[]", "data"),
        ("int64[]", "integers"),
    ],
}
# Names of types in IDL, which the generated classes use, where they differ.
IDL = {"bool": "boolean", "float64": "double"}
TEXT = "µV Δ 皮膚 🫀"


def _idl(name: str) -> str:
    element = name.removesuffix("[]")
    idl = IDL.get(element, element)
    return idl if name == element else f"sequence<{idl}>"


def _round_trip(workspace: Workspace, kind: str, fields: dict[str, Any]) -> dict[str, Any]:
    """Fields that were read, and the fields' types, of a message that was serialized."""
    name = f"biosensor_msgs/msg/{kind}"
    result = subprocess.run(
        workspace.program("tests.system.message_fields", name, json.dumps(fields)),
        env=workspace.environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def _header(frame_id: str) -> dict[str, Any]:
    # Times of ROS are negative before 1970, and their nanoseconds count on from there.
    return {"stamp": {"sec": -(2**31), "nanosec": 999_999_999}, "frame_id": frame_id}


def test_there_are_no_other_messages() -> None:
    assert {file.stem for file in SOURCES.iterdir()} == MESSAGES.keys()


@pytest.mark.parametrize(("kind", "fields"), MESSAGES.items(), ids=MESSAGES)
def test_a_message_has_exactly_the_fields_of_its_definition(
    workspace: Workspace, kind: str, fields: list[tuple[str, str]]
) -> None:
    lines = (SOURCES / f"{kind}.msg").read_text().splitlines()
    declared = (line.partition("#")[0].split() for line in lines)
    assert [tuple(words) for words in declared if words] == fields
    types = _round_trip(workspace, kind, {})["types"]
    assert list(types.items()) == [(name, _idl(type_name)) for type_name, name in fields]


@pytest.mark.parametrize("kind", MESSAGES)
def test_the_definition_is_installed_for_other_languages(workspace: Workspace, kind: str) -> None:
    share = workspace.install / "biosensor_msgs" / "share"
    definition = share / "biosensor_msgs" / "msg" / f"{kind}.msg"
    assert definition.read_text() == (SOURCES / f"{kind}.msg").read_text()
    index = share / "ament_index" / "resource_index" / "rosidl_interfaces" / "biosensor_msgs"
    assert f"msg/{kind}.msg" in index.read_text().splitlines()


@pytest.mark.parametrize("text", ["", f'{TEXT}\n["two", "lines"]'], ids=["empty", "any"])
def test_an_event_round_trips(workspace: Workspace, text: str) -> None:
    fields = {"header": _header(TEXT), "sequence": 2**64 - 1, "data": text}
    assert _round_trip(workspace, "Event", fields)["fields"] == fields


@pytest.mark.parametrize(
    "fields",
    [
        {
            "header": _header(""),
            "sequence": 2**53 + 1,
            "lost": -1,
            "lost_is_estimated": False,
            "labels": [],
            "units": [],
            "offsets_ns": [],
            "data": [],
            "integers": [],
        },
        {
            "header": _header(TEXT),
            "sequence": 2**64 - 1,
            "lost": 2**63 - 1,
            "lost_is_estimated": True,
            "labels": ["", TEXT, "AF3"],
            "units": ["microvolts", "", TEXT],
            "offsets_ns": [0, 2**53 + 1, 2**63 - 1, -(2**63)],
            "data": [float("nan"), float("inf"), -float("inf"), -0.0, 5e-324, 0.1, 1.7e308],
            "integers": [2**53 + 1, -(2**53) - 1, 2**63 - 1, -(2**63)],
        },
    ],
    ids=["empty", "extreme"],
)
def test_samples_round_trip(workspace: Workspace, fields: dict[str, Any]) -> None:
    read = _round_trip(workspace, "Samples", fields)["fields"]
    # As text NaN equals itself, and zero differs from minus zero.
    assert json.dumps(read) == json.dumps(fields)


# Messages of a package that somebody has built, which ``ros_to_lsl`` knows by their type alone.
DEADLINE_S = 60.0
COUNT = 50
STAMP_LIMIT_S = 0.01
TOLD = ("type", "type_hash", "frame_id", "stamp_source")
PUBLISHER = """
import itertools, time, rclpy
from builtin_interfaces.msg import Duration
from lab_msgs.msg import Finger, Grip
rclpy.init()
node = rclpy.create_node("gripper")
publisher = node.create_publisher(Grip, "/grip", 100)
for n in itertools.count():
    grip = Grip(state=Grip.STATE_CLOSED if n % 20 > 9 else Grip.STATE_OPEN, count=n, object="cup")
    grip.header.stamp.sec, grip.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
    grip.header.frame_id = "palm"
    grip.force, grip.fingers = [n + 0.5, -1.0], [Finger(angle=0.25), Finger(touches=True)]
    grip.held = Duration(sec=grip.header.stamp.sec, nanosec=grip.header.stamp.nanosec)
    publisher.publish(grip)
    time.sleep(0.01)
"""
LABELS = [
    "state",
    "force[0]",
    "force[1]",
    "fingers[0].angle",
    "fingers[0].touches",
    "fingers[1].angle",
    "fingers[1].touches",
    "held",
    "count",
]


@pytest.fixture(scope="module")
def environment(
    toolchain: Toolchain, workspace: Workspace, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, str]:
    """Variables of a shell in which both workspaces were sourced: ours, then that of the lab."""
    lab = tmp_path_factory.mktemp("lab-workspace")
    shutil.copytree(ROOT / "tests" / "system" / "lab_msgs", lab / "src" / "lab_msgs")
    toolchain.build(lab)
    overlay = '. "$0" && exec env -0'
    setup = str(lab / "install" / "local_setup.bash")
    listing = toolchain.run(lab, *workspace.command("bash", "-c", overlay, setup))
    return dict(entry.split("=", 1) for entry in listing.rstrip("\0").split("\0"))


def test_a_message_type_of_the_lab_is_sent_by_its_type(
    workspace: Workspace, environment: dict[str, str], start: Callable[..., Program]
) -> None:
    program = str(workspace.install / "lsl_to_ros" / "lib" / "lsl_to_ros" / "ros_to_lsl")
    node = start("node", [program, "--ros-args", "-p", "topics:=[/grip]"], env=environment)
    start("publisher", [workspace.python, "-c", PUBLISHER], env=environment)

    numbers = _open("grip", node)
    info = ET.fromstring(numbers.info().as_xml())
    assert [each.findtext("label") for each in info.iterfind("desc/channels/channel")] == LABELS
    told = {name: info.findtext(f"desc/ros/{name}") or "" for name in TOLD}
    assert told.pop("type_hash").startswith("RIHS01_")
    assert told == {"type": "lab_msgs/msg/Grip", "frame_id": "palm", "stamp_source": "header"}

    offset_s = system_minus_lsl_ns() / NS_PER_S
    rows = _pull(numbers, COUNT, node)
    first = round(rows[0][0][-1])
    for n, (row, stamp) in enumerate(rows, start=first):
        *before, held_s, count = row
        assert (before, count) == ([n % 20 > 9, n + 0.5, -1.0, 0.25, 0, 0, 1], n), node.output
        assert stamp + offset_s == pytest.approx(held_s, abs=STAMP_LIMIT_S)
    texts = _pull(_open("grip__text", node), 3, node)
    states = [json.loads(text)["state"] for (text,), _ in texts if text.startswith("{")]
    assert set(states) <= {"OPEN", "CLOSED"}
    assert states


def _open(name: str, node: Program) -> pylsl.StreamInlet:
    found = pylsl.resolve_byprop("name", name, 1, DEADLINE_S)
    assert found, node.output
    return pylsl.StreamInlet(found[0])


def _pull(inlet: pylsl.StreamInlet, count: int, node: Program) -> list[tuple[list[Any], float]]:
    """Wait for so many samples, with their stamps."""
    rows: list[tuple[list[Any], float]] = []
    while len(rows) < count:
        sample, stamp = inlet.pull_sample(DEADLINE_S)
        assert sample is not None and stamp is not None, node.output
        rows.append((sample, stamp))
    return rows
