"""No data room drops data without reporting it, and the check finds drops that are put in."""

from __future__ import annotations

import ast
import random
import re
from pathlib import Path

import pytest

from tests.refusals.drops import (
    EXCUSE,
    PATTERNS,
    ROOT,
    data_rooms,
    drops,
    is_answer,
    reports_of,
    source_of,
)

ROOMS = data_rooms()
SEEDS = range(20)
KINDS = ("", "/captures/", "/features/", "/recorder/", "/streaming/", "/topics/")
"""Of all rooms, and of each kind of them."""
_REPORTS = re.compile(r"\b_?(refuse|hold|lost|left_out|note)\(|dropped_bytes \+=")
_KINDS = {
    "return": ("if drop_it:", "    return"),
    "continue": ("for _ in (1,):", "    continue"),
    "except": ("try:", "    take_it()", "except ValueError:", "    pass"),
    "filter": ("samples = [each for each in samples if each]",),
    "cut": ("samples, stamps = samples[:100], stamps[:100]",),
    "log": ('self._log.warning("a sample is dropped")',),
}


@pytest.mark.parametrize("pattern", PATTERNS)
def test_no_room_is_forgotten_when_modules_move(pattern: str) -> None:
    assert any(ROOT.glob(pattern)), f"{pattern} is no module any more: say where its code is"


@pytest.mark.parametrize("room", ROOMS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_a_data_room_drops_nothing_unsaid(room: Path) -> None:
    all_found = drops(source_of(room), reports_of(room))
    found = [f"{room.name}:{each.line}: {each.what}" for each in all_found]
    assert not found, (
        f"{', '.join(found)}: report a member of Refusal (biosensor_common/refusal.py) by `refuse`"
        f" before, or say why not: `# {EXCUSE} ...`"
    )


def test_an_excuse_says_why() -> None:
    for room in ROOMS:
        for line in source_of(room).splitlines():
            if EXCUSE in line:
                assert len(line.partition(EXCUSE)[2].split()) >= 2, f"{room.name}: {line.strip()}"


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", KINDS)
def test_three_drops_at_places_of_a_seed_are_found(kind: str, seed: int) -> None:
    chance = random.Random(f"{kind} {seed}")
    for room in chance.sample([each for each in ROOMS if kind in each.as_posix()], 3):
        source = source_of(room)
        statement = chance.choice(_statements(source))
        what = chance.choice(sorted(_KINDS))
        seeded, begin, end = _seeded(source, statement, _KINDS[what])
        all_found = drops(seeded, reports_of(room))
        found = [each for each in all_found if begin <= each.line <= end]
        assert what in {each.what for each in found}, f"{room.name}:{begin}: {what}"


def _statements(source: str) -> list[ast.stmt]:
    """Return where something can be put in: statements behind which nothing is reported."""
    lines = source.splitlines()
    functions = [
        each
        for each in ast.walk(ast.parse(source))
        if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef) and not is_answer(each)
    ]
    return [
        statement
        for body in (each.body for each in functions)
        # A docstring stays the first, and a comment with what it is about.
        for statement in body[isinstance(body[0], ast.Expr) and len(body) > 1 :]
        if not lines[statement.lineno - 2].lstrip().startswith(("#", "@"))
        and not _is_stub(statement)
        and not any(_REPORTS.search(ast.unparse(each)) for each in body)
    ] or [functions[0].body[0]]


def _is_stub(statement: ast.stmt) -> bool:
    """Whether it stands for the body of a protocol's method."""
    return isinstance(statement, ast.Expr) and ast.unparse(statement) == "..."


def _seeded(source: str, before: ast.stmt, lines: tuple[str, ...]) -> tuple[str, int, int]:
    """Put lines before a statement; return where they are."""
    all_lines, at = source.splitlines(), before.lineno - 1
    put = [" " * before.col_offset + line for line in lines]
    return "\n".join([*all_lines[:at], *put, *all_lines[at:]]), at + 1, at + len(put)
