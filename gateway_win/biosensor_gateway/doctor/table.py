"""Lists the checks of the agent's computer.

A new one is a module of `biosensor_gateway.doctor.checks` and a line here. What a computer
without the agent can run, too, is a line of `biosensor_common.doctor.table`.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import cast

from biosensor_common.doctor.check import Category, Check, by_category
from biosensor_common.doctor.table import COMMON_CHECKS

_own = partial(Check, package="biosensor_gateway.doctor.checks")
OWN_CHECKS = (
    _own("settings", Category.PROGRAM, "settings file, state folder, running agent"),
    _own("windows_firewall", Category.NETWORK, "the firewall of Windows"),
    _own("bluetooth", Category.DEVICES, "the Bluetooth adapter", limit_s=14.0),
    _own("serial", Category.DEVICES, "serial ports of the settings"),
    _own("services", Category.DEVICES, "vendors' services, their secrets, LabRecorder"),
    _own("licences", Category.DEVICES, "licences of the vendors' services", limit_s=14.0),
    _own("power", Category.COMPUTER, "sleep, battery, power saving of Bluetooth"),
)


def _ros_checks() -> tuple[Check, ...]:
    """Return the checks of the node, which the agent knows nothing of, where it is installed."""
    if find_spec("rclpy") is None or find_spec("lsl_to_ros") is None:
        return ()
    return cast("tuple[Check, ...]", import_module("lsl_to_ros.doctor.table").ROS_CHECKS)


CHECKS = by_category(*COMMON_CHECKS, *OWN_CHECKS, *_ros_checks())
"""In the order in which they are shown."""
