"""Features of a virtual strap arrive in ROS, and are those that its recording gives."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pylsl
import pytest
import pyxdf
from std_msgs.msg import Float32, Float32MultiArray

from tests.rigs.lab_recorder import LabRecorder

pytestmark = pytest.mark.nightly

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
