"""Starts ``ros_to_lsl``."""

from __future__ import annotations

from lsl_to_ros.command_line import start


def main() -> None:
    """Run the node; see `start`."""
    start("ros_to_lsl", "lsl_to_ros.ros_to_lsl.parameters", "lsl_to_ros.ros_to_lsl.application")


if __name__ == "__main__":
    main()
