"""Starts ``lsl_to_ros``."""

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
    with liblsl.needed_by("lsl_to_ros"):
        settle("lsl_to_ros", sys.argv[1:], _usage)
        # Imported only now: ROS's libraries start threads at import, and the arenas of these stay.
        import_module("lsl_to_ros.application").run()


def _usage() -> str:
    return import_module("lsl_to_ros.parameters.streams").usage()


if __name__ == "__main__":
    main()
