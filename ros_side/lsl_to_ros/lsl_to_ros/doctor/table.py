"""Lists the checks of the node's computer."""

from __future__ import annotations

from biosensor_common.doctor.check import Category, Check, by_category
from biosensor_common.doctor.table import COMMON_CHECKS

ROS_CHECKS = (
    Check(
        "dds",
        Category.ROS,
        "ROS nodes find each other, and the node lsl_to_ros is there once",
        "lsl_to_ros.doctor.checks",
        limit_s=15.0,
    ),
)
"""What any program may add that runs where rclpy is."""

CHECKS = by_category(*COMMON_CHECKS, *ROS_CHECKS)
"""In the order in which they are shown."""
