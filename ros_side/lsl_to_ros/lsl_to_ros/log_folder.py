"""Finds a folder for ROS's log files where the usual one cannot be written."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, MutableMapping
from pathlib import Path

_VARIABLE, _HOME_VARIABLE = "ROS_LOG_DIR", "ROS_HOME"


def ensure_log_folder(environment: MutableMapping[str, str]) -> str:
    """Set a temporary folder where the usual one cannot be written: rclpy does not start without.

    Returns
    -------
    str
        A sentence on it; empty if the usual one is used.
    """
    usual = usual_folder(environment)
    try:
        usual.mkdir(parents=True, exist_ok=True)
        if os.access(usual, os.W_OK):
            return ""
    except OSError:
        pass
    environment[_VARIABLE] = instead = tempfile.mkdtemp(prefix="ros-log-")
    return f"{usual} cannot be written; ROS's log files are in {instead} ({_VARIABLE} changes that)"


def usual_folder(environment: Mapping[str, str]) -> Path:
    """Return where rcl writes its log files."""
    if environment.get(_VARIABLE):
        return Path(environment[_VARIABLE]).expanduser()
    home = environment.get(_HOME_VARIABLE) or "~/.ros"
    return Path(home).expanduser() / "log"
