"""ROS's log files go elsewhere where their folder cannot be written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from lsl_to_ros.ros_environment import ensure_log_folder, usual_folder


def test_the_folder_is_that_of_rcl(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert usual_folder({}) == tmp_path / ".ros/log"
    assert usual_folder({"ROS_HOME": "/opt/r"}) == Path("/opt/r/log")
    assert usual_folder({"ROS_HOME": "/opt/r", "ROS_LOG_DIR": "~/logs"}) == tmp_path / "logs"


def test_a_folder_that_can_be_written_is_used(tmp_path: Path) -> None:
    environment = {"ROS_HOME": str(tmp_path / "ros")}
    assert ensure_log_folder(environment) == ""
    assert environment.keys() == {"ROS_HOME"}


def test_another_one_takes_the_place_of_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    # Below a file there is no folder, not even for root.
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    environment = {"ROS_HOME": str(in_the_way)}
    said = ensure_log_folder(environment)
    instead = Path(environment["ROS_LOG_DIR"])
    assert said.startswith(
        f"{in_the_way / 'log'} cannot be written; ROS's log files are in {instead}"
    )
    assert os.access(instead, os.W_OK)
    instead.rmdir()
