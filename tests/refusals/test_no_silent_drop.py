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
    "unread": ("some_samples = take_it()", "if len(some_samples):", "    some_samples = []"),
    "part": ("some_samples = take_it()", "kept = some_samples[:100]", "use_it(kept)"),
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


HAND_ON = "    for each in samples:\n        self._push(each)\n"


@pytest.mark.parametrize(
    ("body", "what"),
    [
        ("    samples = []\n" + HAND_ON, "unread"),
        (
            "    rows = self._rows\n    if len(rows) > 9:\n        rows = []\n    push(rows)",
            "unread",
        ),
        ("    if self._rows:\n        self._rows = np.empty((0, 3))", "unread"),
        ("    rows = read()\n    rows = read()\n    push(rows)", "unread"),
        ("    few = samples[:9]\n    for each in few:\n        push(each)", "part"),
        ("    push(samples[samples > 0])", "part"),
        ("    push(samples[~is_odd], len(samples))", "part"),
        ("    block = replace(block, rows=block.rows[1:])\n    push(block)", "part"),
        ("    block = Block(block.rows[1:], block.stamps[1:])\n    push(block)", "part"),
        (
            "    while True:\n        rows = read()\n        see(rows)\n        push(rows[:9])",
            "part",
        ),
        ("    if odd:\n        push(samples[:9])\n        return\n    push(samples)", "part"),
        ("    if not samples:\n        return samples\n    samples = []\n" + HAND_ON, "unread"),
        ("    push(islice(samples, 9))", "filter"),
        ("    return list(filter(bool, samples))", "filter"),
        ("    push(np.delete(samples, 1))", "filter"),
    ],
)
def test_data_that_an_assignment_leaves_unread_is_found(body: str, what: str) -> None:
    source = f"def take(self, samples, block):\n{body}\n"
    assert what in {each.what for each in drops(source)}, source


@pytest.mark.parametrize(
    "body",
    [
        "    rows = []\n    for each in samples:\n        rows.append(each)\n    push(rows)",
        "    push(self._rows)\n    self._rows = []",
        "    rows, self._rows = self._rows, []\n    push(rows)",
        "    few, rest = samples[:9], samples[9:]\n    push(few, rest)",
        "    few = samples[:9]\n    rest = samples[9:]\n    push(few, rest)",
        "    for begin in range(0, 9, 3):\n        push(samples[begin : begin + 3])",
        "    rows = usual()\n    if other:\n        rows = read()\n    push(rows)",
        "    self._refusals.refuse(CUT)\n    samples = []\n" + HAND_ON,
    ],
)
def test_data_that_goes_on_elsewhere_is_no_drop(body: str) -> None:
    source = f"def take(self, samples, block):\n{body}\n"
    assert not [e for e in drops(source) if e.what in ("unread", "part")], source


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
