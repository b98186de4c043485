"""Starts ``lsl_to_ros``."""

from __future__ import annotations

from lsl_to_ros.command_line import start


def main() -> None:
    """Run the node; see `start`."""
    start("lsl_to_ros", "lsl_to_ros.parameters.streams", "lsl_to_ros.application")


if __name__ == "__main__":
    main()
