"""Outside its own folders nothing names a sensor: who adds one touches nothing else.

Looked at is code: names, strings and comments of Python, and all of other files. Docstrings, and
the comments that explain the fields of a class, may give examples. A sensor's own are
``devices/<sensor>`` and ``tests/<sensor>``. Of the tests, those count that go over all sensors; a
scenario may choose a sensor that suits it.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.registry import declaration, sensor_names
from tests.rigs.turns import turn_of, turns

ROOT = Path(__file__).parents[2]
DEVICES = ROOT / "gateway_win" / "biosensor_gateway" / "devices"
OF_ALL_SENSORS = (
    "tests/rigs/lab.py",
    "tests/rigs/lab_client.py",
    "tests/rigs/bluez/*.py",
    "tests/rigs/hosts/pair.py",
    "tests/faults/*.py",
    "tests/e2e/test_every_sensor.py",
    "tests/e2e/test_demo.py",
    "benchmarks/agent_load.py",
    "benchmarks/decoder_speed.py",
    "benchmarks/tape.py",
    "tests/ble/**/*.py",
    "tests/contracts/**/*.py",
    "tests/time_spent/**/*.py",
    "tests/time_spent/*.toml",
    "tests/nightly/*.py",
    "tests/nightly/*.toml",
    "installer/**/*.py",
    "installer/*.nsi",
    "installer/*.spec",
)
NAMED_ON_PURPOSE = {
    # What others send, a sensor's manufacturer among them.
    "common/biosensor_common/known_senders.py": {"emotiv"},
    # What the original framework's nodes publish; it is finished and gets no further sensor.
    "ros_side/lsl_to_ros/lsl_to_ros/topics/originals.py": {
        "polar_h10",
        "empatica_e4",
        "shimmer3_gsr",
        "emotiv_insight",
    },
    # The extra of the sensor that needs one, by the name of what it brings.
    "pyproject.toml": {"brainflow"},
}


def own_words() -> re.Pattern[str]:
    """Name, manufacturer and model of each sensor, as words and as parts of a name."""
    words: set[str] = set()
    for name in sensor_names():
        spec = declaration(name)
        words |= {spec.name, *spec.manufacturer.split()[:1], *spec.model.split()[:1]}
    # Of two that begin alike, the whole one is to be found.
    longest_first = sorted(filter(None, words), key=len, reverse=True)
    alternatives = "|".join(re.escape(word) for word in longest_first)
    return re.compile(rf"(?<![a-z])(?:{alternatives})(?![a-z])", re.IGNORECASE)


def files() -> Iterator[Path]:
    for part in ("common", "gateway_win", "ros_side"):
        # Tests of the packages may take any sensor for an example.
        found = (ROOT / part).rglob("*.py")
        folders = (path for path in found if not {"build", "test"} & set(path.parts))
        yield from (path for path in folders if DEVICES not in path.parent.parents)
        yield from (ROOT / part).rglob("pyproject.toml")
    yield ROOT / "pyproject.toml"
    for pattern in OF_ALL_SENSORS:
        yield from ROOT.glob(pattern)


def code(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of what is looked at."""
    source = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        yield from enumerate(source.splitlines(), start=1)
        return
    docstrings = {
        line
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    of_fields = set(_lines_of_fields(ast.parse(source)))
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        line = token.start[0]
        explains_a_field = token.type == tokenize.COMMENT and line in of_fields
        if line not in docstrings and not explains_a_field:
            yield line, token.string


def _lines_of_fields(module: ast.Module) -> Iterator[int]:
    """Lines of the fields of classes, each with those between it and what stands above it."""
    for each in ast.walk(module):
        if isinstance(each, ast.ClassDef):
            above = each.lineno
            for statement in each.body:
                end = statement.end_lineno or statement.lineno
                if isinstance(statement, ast.AnnAssign):
                    yield from range(above + 1, end + 1)
                above = end


def named(path: Path, words: re.Pattern[str]) -> list[str]:
    name = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
    allowed = NAMED_ON_PURPOSE.get(name.as_posix(), set[str]())
    return [
        f"{name}:{line}: {text}"
        for line, text in code(path)
        if not {found.lower() for found in words.findall(text)} <= allowed
    ]


def test_nothing_names_a_sensor_outside_its_own_folders() -> None:
    looked_at = list(files())
    assert len(looked_at) > 200
    words = own_words()
    assert [found for path in looked_at for found in named(path, words)] == []


@pytest.mark.parametrize(
    ("line", "is_found"),
    [
        ('SENSORS = ("polar_h10",)', True),
        ("def _zephyr() -> None: ...", True),
        ('message = f"start the E4 {1}"', True),
        ("x = 1  # as Emotiv does", True),
        ("class A:\n    # As of an E4.\n    x: int", False),
        ("class A:\n    x: int  # As of an E4.", False),
        ("class A:\n    x: str = 'zephyr'  # The usual one.", True),
        ("class A:\n    # As of an E4.\n    x = 1", True),
        ('"""Such as zephyr."""', False),
        ("polarity = 1", False),
    ],
)
def test_what_counts_as_a_name(tmp_path: Path, line: str, *, is_found: bool) -> None:
    path = tmp_path / "module.py"
    path.write_text(f"{line}\n")
    assert bool(named(path, own_words())) == is_found


# Sensors take turns where all at once would be more than the computer carries.

NAMES = st.lists(st.sampled_from(sensor_names()), unique=True, min_size=1)


@given(NAMES, st.integers(1, 9))
def test_each_has_one_turn_and_no_turn_has_too_many(names: list[str], most: int) -> None:
    dealt = turns(names, most)
    assert Counter(chain.from_iterable(dealt)) == Counter(names)
    sizes = [len(turn) for turn in dealt]
    assert max(sizes) <= most
    assert max(sizes) - min(sizes) <= 1
    assert len(dealt) == -(-len(names) // most)
    for name in names:
        assert name in turn_of(name, dealt)
    for turn in dealt:
        assert list(turn) == [name for name in names if name in turn]
