"""Starts ``ros_to_lsl``."""

from __future__ import annotations

import os
import signal
import sys
from importlib import import_module

from biosensor_common import liblsl
from biosensor_common.process_limits import limit_arenas, raise_limit
from lsl_to_ros.command_line import settle


def main() -> None:
    """Run the node until SIGINT or SIGTERM; exit code 0, or 2 for unusable settings."""
    # Until the node handles it, Ctrl-C would end imports with a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    raise_limit()
    limit_arenas(os.environ)
    liblsl.provide(os.environ)
    with liblsl.needed_by("ros_to_lsl"):
        # Imported only now: ROS's libraries start threads at import, and the arenas of these stay.
        settle("ros_to_lsl", sys.argv[1:], _usage)
        import_module("lsl_to_ros.ros_to_lsl.application").run()


def _usage() -> str:
    return import_module("lsl_to_ros.ros_to_lsl.parameters").usage()


if __name__ == "__main__":
    main()
