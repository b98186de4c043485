"""Starts a node, and parses the command line outside of ``--ros-args``, which ROS parses itself."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import import_module
from textwrap import fill

from biosensor_common import liblsl
from biosensor_common.process_limits import limit_arenas, raise_limit

_BEGIN, _END = "--ros-args", "--"
_HELP = ("-h", "--help")
_OF_ROS = ("-p", "--param", "--params-file", "-r", "--remap")
_MODULES_OF_ROS = frozenset(
    {
        "builtin_interfaces",
        "diagnostic_msgs",
        "rcl_interfaces",
        "rclpy",
        "rosidl_parser",
        "sensor_msgs",
        "std_msgs",
    }
)
_WIDTH, _INDENT = 80, 18


def start(program: str, parameters: str, application: str) -> None:
    """Run a node until SIGINT or SIGTERM; exit code 0, or 2 for unusable settings.

    Parameters
    ----------
    parameters, application
        Names of the modules with ``usage`` and ``run``.
    """
    # Until the node handles it, Ctrl-C would end imports with a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    raise_limit()
    limit_arenas(os.environ)
    liblsl.provide(os.environ)
    with liblsl.needed_by(program):
        settle(program, sys.argv[1:], lambda: import_module(parameters).usage())
        try:
            # Imported only now: ROS's libraries start threads at import, whose arenas stay.
            module = import_module(application)
        except ModuleNotFoundError as error:
            sentence = _without_ros(error)
            if not sentence:
                raise
            sys.stderr.write(f"{program}: {sentence}\n")
            raise SystemExit(1) from None
        module.run()


def _without_ros(error: ModuleNotFoundError) -> str:
    """Return a sentence if the missing module is one of ROS, else an empty text."""
    if (error.name or "").partition(".")[0] not in _MODULES_OF_ROS:
        return ""
    return (
        f"ROS 2 is missing, there is no module {error.name}; source its setup file, as in: source "
        "/opt/ros/jazzy/setup.bash; or, on Linux x86-64, run: pip install 'biosensor-gateway[ros]'"
    )


def settle(program: str, arguments: Sequence[str], usage: Callable[[], str]) -> None:
    """Print the help on request and exit; exit with code 2 for an unknown argument.

    Raises
    ------
    SystemExit
        In both cases.
    """
    strange = list(outside(arguments))
    if any(each in _HELP for each in arguments):
        sys.stdout.write(usage())
        raise SystemExit(0)
    if strange:
        sys.stderr.write(f"{program}: {unknown(strange[0])}\n")
        raise SystemExit(2)


def outside(arguments: Sequence[str]) -> Iterator[str]:
    """Return the arguments that ROS does not parse."""
    is_ros = False
    for argument in arguments:
        if argument == _BEGIN:
            is_ros = True
        elif is_ros and argument == _END:
            is_ros = False
        elif not is_ros and argument != _END:
            yield argument


def unknown(argument: str) -> str:
    """Return the error message for an unknown argument, with a suggestion."""
    if argument in _OF_ROS or ":=" in argument:
        return f"{argument} must come after --ros-args, as in --ros-args -p name:=value"
    return f"there is no argument {argument}; --help lists the parameters"


def page(begin: str, parts: Mapping[str, Mapping[str, str]]) -> str:
    """Format a help text for a console of 80 columns.

    Parameters
    ----------
    begin
        Purpose and usage of the program.
    parts
        Descriptions of the parameters, by heading.
    """
    lines = [begin]
    for heading, texts in parts.items():
        lines += [heading, *(_line(name, text) for name, text in texts.items()), ""]
    return "\n".join(lines)


def _line(name: str, text: str) -> str:
    first = f"  {name.ljust(_INDENT - 3)} "
    return fill(text, _WIDTH, initial_indent=first, subsequent_indent=" " * _INDENT)
