"""Finds problems of this ROS computer and how to fix them.

The list of checks, and the checks for any computer with LSL, are in `biosensor_common.doctor`; the
check of ROS is here (`dds`). ``ros2 doctor`` shows the findings (`ros2_doctor`), and so does
``python3 -m lsl_to_ros.doctor``, which needs no ros2doctor.
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution

from biosensor_common.doctor.check import Guide

_BY_COLCON, _BY_PIP = "lsl_to_ros", "biosensor-gateway"


def _distribution() -> str:
    """Return the distribution of the node: its ROS package, or the wheel with all packages."""
    try:
        distribution(_BY_COLCON)
    except PackageNotFoundError:
        return _BY_PIP
    return _BY_COLCON


GUIDE = Guide(
    program="the node",
    package="lsl_to_ros",
    distribution=_distribution(),
    install="in the workspace: python3 -m colcon build && source install/setup.bash",
    install_pylsl=(
        "in the environment of the workspace: pip install 'pylsl>=1.18'; without one: pip install "
        "--user --break-system-packages 'pylsl>=1.18'"
    ),
    libraries={
        "numpy": "sudo apt install python3-numpy",
        "rclpy": "sudo apt install ros-$ROS_DISTRO-rclpy, then: source "
        "/opt/ros/$ROS_DISTRO/setup.bash",
    },
    ask_itself=(
        "put into ~/lsl_api/lsl_api.cfg, each on its own line: [lab], KnownPeers = {127.0.0.1}, "
        "[ports], PortRange = 256"
    ),
    ask_others=(
        'ros2 launch lsl_to_ros lsl_to_ros.launch.py known_peers:="[ADDRESS]", with the address '
        "of the computer whose streams are missing"
    ),
    correct_file=(
        "in your lsl_api.cfg: SessionID below [lab] as the node's parameter session_id, "
        "PortRange = 256 below [ports]"
    ),
    edit="the file that params_file names, then start the node again",
    alone=(
        "run it alone: python3 -m lsl_to_ros.doctor --only {check}; if it fails again, report it "
        "with the output of: python3 -m lsl_to_ros.doctor --json"
    ),
)
