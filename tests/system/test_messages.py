"""The messages of `biosensor_msgs`, as colcon has built them."""

from __future__ import annotations

import json
import subprocess
from typing import Any

import pytest

from tests.system.toolchain import ROOT
from tests.system.workspace import Workspace

pytestmark = pytest.mark.system

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
        workspace.program("tests.system.round_trip", name, json.dumps(fields)),
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
