"""A program: all helps, and some commands, where pylsl finds no library. Prints JSON."""

from __future__ import annotations

import contextlib
import ctypes.util
import io
import json
import os
import sys
from typing import Any

_is_file = os.path.isfile


def _has_no_library(path: Any) -> bool:
    return "lsl" not in os.path.basename(str(path)) and _is_file(path)  # noqa: PTH119


os.path.isfile = _has_no_library
ctypes.util.find_library = lambda name: None  # pyright: ignore[reportAttributeAccessIssue]

from biosensor_gateway.cli import main  # noqa: E402 - only then
from biosensor_gateway.cli.app import COMMANDS  # noqa: E402

USES = (
    "run --no-ask --simulate polar_h10",
    "test polar_h10 --simulate --seconds 1",
    "record start --here --file study.xdf",
    "features",
    "page --lsl --no-open",
)


def call(command: str) -> tuple[int, str]:
    """Return exit code and what was said as an error."""
    sys.argv = ["biosensor-gateway", *command.split()]
    errors = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
        try:
            main()
        except SystemExit as ended:
            return int(ended.code or 0), errors.getvalue()
        except BaseException as error:  # noqa: BLE001 - a traceback is what must not be
            return -1, repr(error)
    return 0, errors.getvalue()


def helps() -> dict[str, tuple[int, str]]:
    """Ask each command for its help, and each of a group."""
    said: dict[str, tuple[int, str]] = {}
    for each in COMMANDS:
        said[f"{each.name} --help"] = call(f"{each.name} --help")
        for name in getattr(each.load(), "commands", {}):
            said[f"{each.name} {name} --help"] = call(f"{each.name} {name} --help")
    return said


if __name__ == "__main__":
    json.dump({"helps": helps(), "uses": {each: call(each) for each in USES}}, sys.stdout)
