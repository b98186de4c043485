"""On what was measured, without anything that names the machine."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

import pylsl
from rclpy.utilities import get_rmw_implementation_identifier


def facts() -> dict[str, str]:
    """Return what a reader needs to compare figures."""
    return {
        "cpu": _cpu_model(),
        "cores": str(os.cpu_count()),
        "system": platform.system(),
        "python": platform.python_version(),
        "pylsl": version("pylsl"),
        "liblsl": f"{pylsl.library_version() / 100:.2f}",
        "rclpy": version("rclpy"),
        "rmw": get_rmw_implementation_identifier(),
    }


def load() -> float:
    """Return the load average of the last minute."""
    return round(os.getloadavg()[0], 2)


def _cpu_model() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.machine()
