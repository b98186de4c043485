"""The report of how the code is cut counts what is in a small tree, and fits a terminal."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.docs import house

TREE = {
    "common/box/__init__.py": '"""A box."""\n',
    "common/box/lid.py": '''"""Closes a box."""

from typing import NamedTuple, Protocol


class Lid(Protocol):
    """Closes."""

    size: int

    def close(self, how: str) -> None: ...


class Cap:
    """Closes by a thread.

    Parameters
    ----------
    size
    colour, *rest
        By name.
    turns : shape (n,)

    Returns
    -------
    nothing
    """

    def __init__(self, size: int) -> None:
        self.size = size

    def close(self, how: str) -> None:
        """Close."""
        self._turn(how)

    async def turn(self, *how: str, by: int) -> None:
        await self._turn(*how, by=by)

    def _turn(self, how: str) -> None:
        print(how, self.size)  # The second tells of the first.


class Label(NamedTuple):
    """Is built once."""

    text: str


class Mark(NamedTuple):
    """Is built twice."""

    text: str


LABEL, MARKS = Label("a"), (Mark("b"), Mark("c"))  # noqa: E501
''',
    "common/box/closing.py": '''"""Closes."""

from box.lid import Cap


def close(how: str) -> None:
    """Close."""
    Cap(1).close(how.lower())
''',
    "gateway_win/crate/closing.py": "# Of another room.\nimport box.closing\n" + "\n" * 500,
    "gateway_win/crate/devices/one/driver.py": "import box.closing\n",
    "gateway_win/crate/devices/two/driver.py": "def f():\n" + "    f(1)\n" * 60,
    "gateway_win/build/lib/copy.py": "import box.lid\n",
    "tests/test_lid.py": "import box.lid\n",
}
FOUND = {
    "modules with one importer": ["common/box/lid.py <- box.closing"],
    "  in the same folder": ["common/box/lid.py <- box.closing"],
    "modules under 60 lines": [
        "common/box/closing.py 8",
        "common/box/lid.py 55",
        "gateway_win/crate/devices/one/driver.py 1",
    ],
    "modules of one function": ["common/box/closing.py", "gateway_win/crate/devices/two/driver.py"],
    "modules named by a gerund": ["common/box/closing.py", "gateway_win/crate/closing.py"],
    "modules that share a file name, but in devices": [
        "common/box/closing.py",
        "gateway_win/crate/closing.py",
    ],
    "records built at one place": ["common/box/lid.py:43 Label"],
    "functions that only hand on their arguments": [
        "common/box/lid.py:32 close",
        "common/box/lid.py:36 turn",
    ],
    "protocols with one implementation": ["common/box/lid.py:6 Lid <- Cap"],
    "documented parameters without text": ["common/box/lid.py:14 Cap size"],
    "modules over 500 lines": ["gateway_win/crate/closing.py 502"],
    "functions over 60 lines": ["gateway_win/crate/devices/two/driver.py:1 f 61"],
}


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name, text in TREE.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


def test_each_count_is_made_of_what_is_in_the_tree(tree: Path) -> None:
    assert house.second_look(tree) == FOUND


def test_the_report_has_every_count_and_fits_a_terminal(tree: Path) -> None:
    lines = list(house.report(tree))
    assert max(map(len, lines)) <= 80
    counts = {line[:48].rstrip(): line[48:].split() for line in lines}
    assert counts.pop("product: comments in 100 lines") == ["0.3"]
    assert counts.pop("tests: comments in 100 lines") == ["0.0"]
    assert counts.pop("product") == ["6", "modules", "628", "lines"]
    assert counts.pop("tests") == ["1", "modules", "1", "lines"]
    assert counts.pop("  crate.devices") == ["2", "modules", "62", "lines"]
    assert {name: counts[name] for name in FOUND} == {
        name: [str(len(found))] for name, found in FOUND.items()
    }
