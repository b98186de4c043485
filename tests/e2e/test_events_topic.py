"""Events, markers and features reach ROS as they were sent."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pylsl
import pytest
import pyxdf
from std_msgs.msg import Float32, Float32MultiArray, String

from biosensor_common.errors import GatewayError
from biosensor_gateway.agent import control
from biosensor_gateway.settings.places import state_folder
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

# The agent's events reach ROS as a topic, with nothing said of them on the ROS side.


def test_events_are_a_topic_of_strings(
    programs: Any, listener: Any, wait_until: Callable[..., None]
) -> None:
    messages = listener.listen(String, "/biosensors/gateway/events")
    programs.node()
    with SteeredBioHarness() as device:
        programs.agent(
            f'[[device]]\nsensor = "zephyr"\nunit = "SIM3"\nport = "{device.port}"\n'
            "[events]\nheartbeat_s = 1\n"
        )

        def heard(kind: str) -> list[dict[str, Any]]:
            events = [json.loads(message.data) for message in messages]
            return [event for event in events if event["event"] == kind]

        wait_until(
            lambda: any("streaming" in beat["devices"].values() for beat in heard("heartbeat")),
            "a sign of life",
        )
        device.drop_link(2.0)
        wait_until(lambda: heard("gap_end"), "the end of the gap")
    for kind in ("disconnected", "gap_start", "gap_end"):
        (event, *_) = heard(kind)
        assert (event["sensor"], event["unit"]) == ("zephyr", "SIM3")
    assert heard("gap_end")[0]["lost"]["ecg"] > 0


# A marker of the experimenter reaches ROS, with nothing said of it on the ROS side.
@pytest.mark.seam
def test_a_marker_is_a_string_with_its_text(
    programs: Any, listener: Any, wait_until: Callable[..., None]
) -> None:
    messages = listener.listen(String, "/biosensors/gateway/markers")
    programs.node()
    programs.agent("")

    def marked() -> dict[str, Any]:
        return control.ask(state_folder(), "mark", {"marker": "Stück 1", "kind": "button"})

    def heard() -> list[dict[str, Any]]:
        return [json.loads(message.data) for message in messages]

    def is_heard() -> bool:
        # Until the node and its subscriber are there, nobody hears a marker.
        with suppress(GatewayError):
            marked()
        return bool(heard())

    wait_until(is_heard, "a first marker")
    sent = marked()
    wait_until(lambda: heard()[-1]["id"] == sent["id"], "the marker")
    assert heard()[-1] == {"marker": "Stück 1", "kind": "button", **sent}
    undone = control.ask(state_folder(), "undo-marker")
    wait_until(lambda: heard()[-1]["id"] == undone["id"], "its undoing")
    assert (heard()[-1]["kind"], heard()[-1]["of"]) == ("undo", sent["id"])
    ids = [each["id"] for each in heard()]
    assert ids == list(range(ids[0], undone["id"] + 1))


# Features of a virtual strap arrive in ROS, and are those that its recording gives.
# What the features are computed of, and what the topics and the recording are compared by.
WANTED = {"ecg", "acc", "beats", "hr_live", "ecg_sqi", "activity_live"}
LEAST_BEATS = 12


def _by_data(path: Path) -> dict[str, Any]:
    reader: Any = pyxdf
    loaded: tuple[Any, Any] = reader.load_xdf(
        path, synchronize_clocks=False, dejitter_timestamps=False
    )
    return {each["info"]["source_id"][0].rpartition("-")[2]: each for each in loaded[0]}


def test_a_virtual_strap_gives_beats_in_ros_and_the_same_from_its_recording(
    programs: Any, listener: Any, wait_until: Callable[..., None], tmp_path: Path
) -> None:
    path, again = tmp_path / "study.xdf", tmp_path / "again.xdf"
    programs.node()
    programs.start("biosensor_gateway.cli", "features")
    programs.start("biosensor_gateway.cli", "run", "--simulate", "polar_h10")

    def is_there(name: str) -> bool:
        return f"/biosensors/polar_h10/{name}" in dict(listener.node.get_topic_names_and_types())

    wait_until(lambda: is_there("ecg_sqi") and is_there("activity_live"), "topics of features")
    beats = listener.listen(Float32MultiArray, "/biosensors/polar_h10/beats")
    rates = listener.listen(Float32, "/biosensors/polar_h10/hr_live")
    resolver = pylsl.ContinuousResolver()

    def names() -> set[str]:
        return {each.source_id().rpartition("-")[2] for each in resolver.results()}

    wait_until(lambda: names() >= WANTED, "streams of the strap and of its features")
    # It looks for a second only and may miss any of them.
    with LabRecorder(path, at_least=len(resolver.results())):
        wait_until(lambda: len(beats) > LEAST_BEATS, "beats in ROS")
    assert [each.data[1] for each in beats[1:]].count(1.0) <= 1
    assert all(40 < each.data < 150 for each in rates)
    # Of the recording, which begins later, the same comes by the same code once it has learnt.
    command = [sys.executable, "-m", "biosensor_gateway.cli", "features", str(path)]
    subprocess.run([*command, "--output", str(again)], check=True, capture_output=True)
    live, offline = _by_data(path), _by_data(again)
    assert offline["beats"]["info"]["desc"][0]["features"][0]["algorithm"]
    found = dict(zip(live["beats"]["time_stamps"], live["beats"]["time_series"], strict=True))
    both = [
        (found[stamp], value)
        for stamp, value in zip(
            offline["beats"]["time_stamps"], offline["beats"]["time_series"], strict=True
        )
        if stamp in found and np.isfinite(value).all()
    ]
    assert len(both) >= 3
    assert all((one == other).all() for one, other in both)
