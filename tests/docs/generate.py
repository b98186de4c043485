"""The parts of the documents that are made from the code, between their markers.

``python -m tests.docs.generate`` writes them all (``make docs``), ``--check`` only says which
are out of date.
"""

from __future__ import annotations

import argparse
import functools
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.docs import (
    catalogue,
    fault_picture,
    tables,
    worked_with,
)

ROOT = Path(__file__).parents[2]
DECISIONS = ROOT / "docs" / "decisions"


@dataclass(frozen=True, slots=True)
class Part:
    """What stands between ``<!-- NAME:begin -->`` and ``<!-- NAME:end -->`` of a document.

    In YAML, ``# NAME:begin`` and ``# NAME:end``.
    Without a name it is the whole file.
    """

    document: str  # Path below the root of the repository.
    name: str
    make: Callable[[], str]  # Returns the present text.


def decisions() -> str:
    """Return a list of the decisions of each room, each with its title."""
    rooms = sorted(path for path in DECISIONS.iterdir() if path.is_dir())
    return "\n" + "\n".join(f"## {room.name.capitalize()}\n\n{_titles(room)}" for room in rooms)


def _titles(room: Path) -> str:
    pages = sorted(room.glob("*.md"))
    titles = [page.read_text(encoding="utf-8").partition("\n")[0][2:] for page in pages]
    lines = [
        f"- [{title}]({room.name}/{page.name})" for title, page in zip(titles, pages, strict=True)
    ]
    return "\n".join(lines) + "\n"


def example(path: str) -> str:
    """Return a program of the examples as a block of code that is called by its name."""
    program = ROOT / "examples" / path
    text = program.read_text(encoding="utf-8")
    return f'\n```python title="{program.name}"\n{text}```\n\n'


EXAMPLES = {
    "two_people_and_a_robot/robot.py": "docs/example.md",
    "two_people_and_a_robot/table.py": "docs/example.md",
    "act_on_features/score.py": "docs/acting-on-features.md",
    "act_on_features/slow_down.py": "docs/tutorial-robot.md",
    "act_on_features/tree.py": "docs/acting-on-features.md",
}
"""Programs that are shown on a page."""

PARTS = (
    Part("README.md", "sensors", tables.sensors),
    Part("docs/topics.md", "topics", tables.topics),
    Part("docs/ros-reference.md", "senders", tables.senders),
    Part("docs/recording-troubleshooting.md", "findings", tables.findings),
    Part("docs/sensors/README.md", "pages", catalogue.pages),
    Part("docs/sensors/README.md", "verified", catalogue.verified),
    Part("docs/sensors/catalogue.md", "catalogue", catalogue.catalogue),
    Part("docs/sensors/worked-with.md", "worked-with", worked_with.worked_with),
    Part("docs/measurements.md", "untidiness", tables.untidiness),
    Part("mkdocs.yml", "sensors", catalogue.navigation),
    Part("docs/decisions/README.md", "decisions", decisions),
    Part("docs/page-api.md", "requests", tables.requests),
    Part("docs/pictures/faults.svg", "", fault_picture.picture),
    *(
        Part(page, Path(path).name, functools.partial(example, path))
        for path, page in EXAMPLES.items()
    ),
)


def updated(text: str, part: Part) -> str:
    """Return a document with the present text of one part.

    Raises
    ------
    ValueError
        If the document does not have the two markers once, in order.
    """
    if not part.name:
        return part.make()
    mark = "      # {}" if part.document.endswith(".yml") else "<!-- {} -->"
    begin, end = mark.format(f"{part.name}:begin"), mark.format(f"{part.name}:end")
    between = re.compile(f"(?<={re.escape(begin)}\n).*?(?={re.escape(end)})", re.DOTALL)
    if text.count(begin) != 1 or text.count(end) != 1 or not between.search(text):
        raise ValueError(f"the lines {begin} and {end} must be there once each, in this order")
    # A function, because backslashes in a replacement string would be escapes.
    return between.sub(lambda _: part.make(), text)


def main(arguments: Sequence[str] | None = None) -> None:
    """Write all parts, or with ``--check`` exit with 1 if one is out of date."""
    parser = argparse.ArgumentParser(description="Update what documents show of the code.")
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--root", type=Path, default=ROOT, help="folder of the documents")
    options = parser.parse_args(arguments)
    stale: list[str] = []
    for part in PARTS:
        document: Path = options.root / part.document
        before = document.read_text(encoding="utf-8") if document.exists() else ""
        after = updated(before, part)
        if after == before:
            continue
        stale.append(part.document)
        if not options.check:
            document.write_text(after, encoding="utf-8")
    if options.check and stale:
        sys.exit(f"out of date: {', '.join(stale)}; run: make docs")


if __name__ == "__main__":
    main()
