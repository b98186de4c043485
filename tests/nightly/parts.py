"""The parts of a nightly run, as ``parts.toml`` has them."""

from __future__ import annotations

import os
import shutil
import sys
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
TABLE = Path(__file__).with_name("parts.toml")

_SELECTED = {
    "ordinary": ("--tier", "nightly", "-m", "not system and not alone"),
    "system": ("--tier", "nightly", "-m", "system and not alone"),
    "alone": ("--tier", "nightly", "-m", "alone"),
    "seams": ("--tier", "seams"),
    "all": ("-m", "not alone"),
}
_LISTS = {"needs", "before", "tests", "commands"}
# The longest files come first, as tests/time_spent/order.toml has them, and heavy ones take turns.
_SIDE_BY_SIDE = ("--dist", "loadfile", "--no-loadscope-reorder")


@dataclass(frozen=True)
class Part:
    """What one job of a workflow runs; each field is described in ``parts.toml``."""

    name: str
    does: str
    needs: tuple[str, ...] = ()
    before: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()
    only: str = "ordinary"
    workers: int = 0
    environment: str = ""
    commands: tuple[str, ...] = ()

    def missing(self) -> list[str]:
        """Return which of its needs this computer does not meet."""
        return [need for need in self.needs if not _is_met(need)]

    def test_command(self, junit: Path) -> list[str]:
        """Return the command that runs its tests and writes their results to a file."""
        side_by_side = (*_SIDE_BY_SIDE, "-n", str(self.workers)) if self.workers else ()
        selected = (*_SELECTED[self.only], *side_by_side, f"--junit-xml={junit}")
        python = f"{self.environment}/bin/python" if self.environment else sys.executable
        return [python, "-m", "pytest", *selected, *self.tests]


def read_parts(table: Path = TABLE, root: Path = ROOT) -> list[Part]:
    """Read the table."""
    return [
        _part(entry, root) for entry in tomllib.loads(table.read_text(encoding="utf-8"))["part"]
    ]


def _part(entry: dict[str, Any], root: Path) -> Part:
    lists: dict[str, Any] = {key: tuple(entry[key]) for key in _LISTS & entry.keys()}
    has_sensors = entry.pop("sensors", False)
    part = Part(**(entry | lists))
    if part.only not in _SELECTED:
        raise ValueError(f'part {part.name}: only = "{part.only}" is none of {list(_SELECTED)}')
    if not has_sensors:
        return part
    # A sensor says in its folder what it emits; who adds one need not touch the table.
    folders = sorted(path.parent.relative_to(root) for path in root.glob("tests/*/streams.json"))
    return replace(part, tests=(*part.tests, *(path.as_posix() for path in folders)))


def _is_met(need: str) -> bool:
    if need == "root":
        return hasattr(os, "geteuid") and os.geteuid() == 0
    return shutil.which(need) is not None
