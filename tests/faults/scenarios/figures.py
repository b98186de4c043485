"""One table for the test report: fault x what was measured x target x figure.

A figure is written into the report of its test, which pytest-xdist carries from its
workers to the process that prints. There the conftest of this folder has to be loaded,
so with ``-n`` name the folder: ``pytest -n 2 tests/faults/scenarios``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import asdict, astuple, dataclass
from pathlib import Path

NAME = "fault-figures"
_PROPERTY = "fault figure"

Record = Callable[[str, str, str, str], None]
"""``record(fault, what, target, measured)``; what is recorded again replaces the first."""
Properties = list[tuple[str, object]]
"""Of a test's report."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One line of the table, as text with units."""

    fault: str
    what: str
    target: str
    measured: str


def recorder(properties: Properties) -> Record:
    """Return a function that writes figures into a test's report."""

    def record(fault: str, what: str, target: str, measured: str) -> None:
        properties.append((_PROPERTY, json.dumps([fault, what, target, measured])))

    return record


class FigureTable:
    """Collects the lines, in the order of faults and measures as they first came."""

    def __init__(self) -> None:
        self._lines: dict[tuple[str, str], Figure] = {}

    def __bool__(self) -> bool:
        return bool(self._lines)

    def collect(self, properties: Iterable[tuple[str, object]]) -> None:
        """Take the figures out of a test's report."""
        for name, value in properties:
            if name == _PROPERTY:
                figure = Figure(*json.loads(str(value)))
                self._lines[figure.fault, figure.what] = figure

    @property
    def figures(self) -> list[Figure]:
        """All lines, those of one fault together."""
        faults = list(dict.fromkeys(fault for fault, _ in self._lines))
        return sorted(self._lines.values(), key=lambda figure: faults.index(figure.fault))

    def markdown(self) -> str:
        """Return the table."""
        lines = [("fault", "what", "target", "measured"), ("---",) * 4]
        lines += [tuple(map(_cell, astuple(figure))) for figure in self.figures]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        padded = [
            " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
            for line in lines
        ]
        return "\n".join(f"| {line} |" for line in padded)

    def write(self, folder: Path) -> None:
        """Write it as markdown and as JSON."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{NAME}.md").write_text(f"{self.markdown()}\n", encoding="utf-8")
        figures = [asdict(figure) for figure in self.figures]
        (folder / f"{NAME}.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")


def _cell(text: object) -> str:
    """Keep a text within its cell."""
    return str(text).replace("|", "\\|").replace("\n", " ")


# How long the scenarios may take.

VARIABLE = "BIOSENSOR_GATEWAY_FAULTS"


def is_long() -> bool:
    """Whether the run may take as long as faults take in a lab."""
    return os.environ.get(VARIABLE) == "long"
