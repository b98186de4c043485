"""What the sensors' pages quote is what the program says."""

from __future__ import annotations

import ast
import re
from collections import Counter
from functools import cache
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs" / "sensors").glob("*.md"))
SAYING = ("common/biosensor_common", "gateway_win/biosensor_gateway")

HOLE = "…"
# The first cell of a table of symptoms; a quotation is a sentence, not a name.
_TABLE = re.compile(r"^\| Symptom \|.*\n\|[-| ]+\|\n((?:\|.*\n)+)", re.MULTILINE)
_CELL = re.compile(r"^\| (.+?) \|", re.MULTILINE)
_QUOTED = re.compile(r"`([^`]+ [^`]+ [^`]+)`")
_COMMAND = "biosensor-gateway "
# Of the letters of a quotation, so many must be the program's own; the rest stands where the
# program fills in a name.
_OWN = 0.6
_SHORTEST = 4


def quotations(page: Path) -> list[str]:
    cells = (_CELL.findall(table) for table in _TABLE.findall(page.read_text("utf-8")))
    found = (_QUOTED.match(cell) for cell in chain.from_iterable(cells))
    return [each[1] for each in found if each and not each[1].startswith(_COMMAND)]


@cache
def said() -> dict[str, frozenset[str]]:
    """All texts of the program, with a hole where it fills something in, and their words."""
    found: set[str] = set()
    for folder in SAYING:
        for path in (ROOT / folder).rglob("*.py"):
            if "simulator" not in path.parts and "simulation" not in path.parts:
                found |= _texts(ast.parse(path.read_text("utf-8")))
    # A quotation cannot have the quotes that the program puts around a setting.
    plain = (text.replace("`", "") for text in found)
    return {text: _words(text) for text in plain if len(text.replace(HOLE, "")) >= _SHORTEST}


def _texts(tree: ast.Module) -> set[str]:
    # Docstrings are not said to anybody.
    silent = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    texts: dict[ast.AST, str] = {}
    for scope in ast.walk(tree):
        # Functions come after what they are in, so that the nearest names are taken.
        if isinstance(scope, ast.Module | ast.FunctionDef | ast.AsyncFunctionDef):
            inside = list(ast.walk(scope))
            names = {} if isinstance(scope, ast.Module) else _names(inside)
            said = (each for each in inside if isinstance(each, ast.Constant | ast.JoinedStr))
            texts |= {each: _text(each, names) for each in said if each not in silent}
    return set(texts.values())


def _names(nodes: list[ast.AST]) -> dict[str, str]:
    """The texts of the names that are given one only."""
    given = [
        (target.id, _text(each.value, {}))
        for each in nodes
        if isinstance(each, ast.Assign)
        for target in each.targets
        if isinstance(target, ast.Name)
    ]
    count = Counter(name for name, _ in given)
    return {name: text for name, text in given if count[name] == 1}


def _text(node: ast.AST, names: dict[str, str]) -> str:
    """A text as it is written; a name in it stands for the text that was put together before."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(each, names) for each in node.values)
    if isinstance(node, ast.FormattedValue) and isinstance(node.value, ast.Name):
        return names.get(node.value.id, HOLE)
    return HOLE


def own(quoted: str, template: str) -> int:
    """Most letters of a quotation that a text has itself; -1 if it cannot have come from it.

    A hole of either stands for anything, also for a part of the other.
    """
    # row[j]: the best for quoted[:i], where the text has been read up to j.
    row = [0] * (len(template) + 1)
    for letter in quoted:
        row = _after(letter, row, template)
    return max(row)


def _after(letter: str, row: list[int], template: str) -> list[int]:
    following = [-1] * len(row)
    for j, best in enumerate(row):
        if letter == HOLE:
            following[j] = max(best, following[j - 1] if j else -1)
            continue
        if j < len(template) and template[j] == HOLE and best >= 0:
            following[j] = max(following[j], best)
        if j and template[j - 1] == HOLE:
            following[j] = max(following[j], following[j - 1])
        if j and template[j - 1] == letter and row[j - 1] >= 0:
            following[j] = max(following[j], row[j - 1] + 1)
    return following


def is_said(quoted: str) -> bool:
    needed = _OWN * len(quoted.replace(HOLE, ""))
    words = _words(quoted)
    # Only what has words in common is compared letter by letter.
    near = (text for text, has in said().items() if 2 * len(words & has) >= len(words))
    return any(own(quoted, text) >= needed for text in near)


def _words(text: str) -> frozenset[str]:
    return frozenset(re.findall(r"\w{2,}", text))


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_sentence_is_one_that_the_program_says(page: Path) -> None:
    # Many are put together: what is the case; what to do.
    wrong = [
        each
        for each in quotations(page)
        if not is_said(each) and not all(is_said(part) for part in each.split("; "))
    ]
    assert wrong == []


def test_pages_quote_something() -> None:
    assert sum(len(quotations(page)) for page in PAGES) > 60


@pytest.mark.parametrize(
    ("quoted", "template", "fits"),
    [
        ("no port; open it", "no port; open it", True),
        ("no port", "there is no port; open it", True),
        ("several Polar H10 are in range (…)", "several … are in range (…): …", True),
        ("no data of … for … s; enabling again", "no data of … for … s; enabling again", True),
        ("it refuses … and more", "it refuses everything and more", True),
        ("no port; close it", "no port; open it", False),
        ("the dongle is full", "the dongle is empty", False),
        ("the dongle is full", "…", False),
    ],
)
def test_how_quotations_are_compared(quoted: str, template: str, fits: bool) -> None:
    needed = _OWN * len(quoted.replace(HOLE, ""))
    assert (own(quoted, template) >= needed) is fits
