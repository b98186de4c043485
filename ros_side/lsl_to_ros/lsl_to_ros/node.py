"""Starts ``lsl_to_ros``."""

from __future__ import annotations

import os
from importlib import import_module

from biosensor_common.heap import limit_arenas
from biosensor_common.open_files import raise_limit


def main() -> None:
    """Run the node until SIGINT or SIGTERM; exit code 0, or 2 for unusable settings."""
    raise_limit()
    limit_arenas(os.environ)
    # Not before: ROS's libraries begin threads when they are imported, whose arenas stay.
    import_module("lsl_to_ros.application").run()


if __name__ == "__main__":
    main()
