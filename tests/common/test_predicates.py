"""Predicates of resolvers: liblsl puts the session before them, and no value escapes."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pylsl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import SpecError
from biosensor_common.lsl.network import matches_query
from biosensor_common.lsl.predicates import (
    EVERYTHING,
    NOTHING,
    Predicate,
    all_of,
    any_of,
    ends_with,
    equals,
    has,
    none_of,
    of_user,
)
from biosensor_gateway.features.outputs import feature_streams
from lsl_to_ros.lsl.inlets import FROM_ROS

ROOT = Path(__file__).parents[2]
PRODUCT = ("common", "gateway_win", "ros_side")
BUILDER = "predicates.py"
# What XPath looks like.
XPATH = re.compile(
    r"\b(name|type|source_id|session_id|uid|hostname|channel_count)\s*=\s*['\"]"
    r"|\b(starts-with|string-length|substring)\(|\btrue\(\)|\bcontains\(\w+,|^desc/\w+ "
)
# Sentences for a person, and what another program is told.
NO_PREDICATES = ("LSL query", "in pylsl", "netsh ")
RESOLVING = {"ContinuousResolver", "resolve_bypred"}
WITHOUT_BRACKETS = {"resolve_byprop", "resolve_stream"}

ECG = pylsl.StreamInfo('it\'s "P01"', "ECG", 1, 130.0, "float32", "p01-ecg")
BUILT = [
    EVERYTHING,
    any_of(equals("type", "PPG"), equals("type", "ECG")),
    any_of(equals("type", "ECG"), equals("type", "PPG"), EVERYTHING),
    all_of(any_of(equals("name", ECG.name()), NOTHING), equals("type", "ECG")),
    any_of(NOTHING, ends_with("source_id", "-ecg")),
    none_of(equals("type", "PPG"), has("desc/ros")),
    none_of(FROM_ROS),
    of_user("type='PPG' or type='ECG'"),
]


@pytest.mark.parametrize("predicate", BUILT)
def test_a_stream_of_another_session_is_never_found(predicate: Predicate) -> None:
    assert matches_query(ECG, predicate)
    # So liblsl writes it.
    assert not matches_query(ECG, f"session_id='another one' and {predicate}")


def test_the_features_of_another_session_are_never_found() -> None:
    info = pylsl.StreamInfo("any", "HR", 1, 0.0, "float32", "p01-hr_live")
    assert matches_query(info, feature_streams())
    assert not matches_query(info, f"session_id='another one' and {feature_streams()}")


@pytest.mark.parametrize(
    ("predicate", "fits"),
    [
        (equals("type", "PPG"), False),
        (ends_with("source_id", "ecg"), True),
        (ends_with("source_id", "p01-ecg and more"), False),
        (ends_with("source_id", "-hr"), False),
        (all_of(), True),
        (any_of(), False),
        (none_of(), True),
        (all_of(equals("type", "ECG"), equals("name", "other")), False),
        (none_of(equals("type", "ECG")), False),
        (equals("name", "it's"), False),
        (equals("source_id", "p01-ecg\0"), False),
        (ends_with("source_id", "ecg\0"), False),
    ],
)
def test_a_predicate_finds_what_it_says(predicate: Predicate, fits: bool) -> None:
    assert matches_query(ECG, predicate) is fits


# liblsl writes a header and reads it again, and XML makes one space of others.
TEXT = st.text(st.sampled_from("ab'\"()[]=/ or,äµ"), min_size=1).map(str.strip).filter(bool)


@given(name=TEXT, other=TEXT)
def test_each_value_is_found_and_no_other(name: str, other: str) -> None:
    info = pylsl.StreamInfo(name, "Test", 1, 0.0, "float32", "any")
    assert matches_query(info, equals("name", name))
    assert matches_query(info, ends_with("name", name))
    assert matches_query(info, equals("name", other)) is (name == other)


@given(text=st.text(st.sampled_from("a=1'\"()[]|/ ")))
def test_what_a_person_wrote_stays_in_its_brackets(text: str) -> None:
    try:
        predicate = of_user(text)
    except SpecError:
        return
    assert not matches_query(ECG, f"session_id='another one' and {predicate}")


@pytest.mark.parametrize(
    "text", ["'", '"', "(", ")", "true()) or (true()", "(]", "name='a)", "true()] | /info[true()"]
)
def test_what_is_open_is_refused(text: str) -> None:
    with pytest.raises(SpecError, match="without its partner"):
        of_user(text)


def _modules() -> Iterator[tuple[Path, ast.Module]]:
    for folder in PRODUCT:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if "build" not in path.parts and path.name != BUILDER:
                yield path, ast.parse(path.read_text("utf-8"))


def _xpath_in(module: ast.AST) -> Iterator[str]:
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(module)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(module):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            is_said = id(node) in docstrings or any(each in node.value for each in NO_PREDICATES)
            if not is_said and XPATH.search(node.value):
                yield f"{node.lineno}: {node.value}"


def _wrong_calls_in(module: ast.AST) -> Iterator[str]:
    for node in ast.walk(module):
        if not isinstance(node, ast.Call):
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else ""
        asked = [*node.args, *(each.value for each in node.keywords if each.arg == "pred")]
        is_text = any(isinstance(each, ast.Constant | ast.JoinedStr) for each in asked[:1])
        if called in WITHOUT_BRACKETS or (called in RESOLVING and is_text):
            yield f"{node.lineno}: {ast.unparse(node)}"


def _makes_predicates(module: ast.AST) -> bool:
    return any(
        isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Predicate"
        for node in ast.walk(module)
    )


def test_doctor_alone_looks_into_other_sessions() -> None:
    using = [path.name for path, _ in _modules() if "IN_ANY_SESSION" in path.read_text("utf-8")]
    assert using == ["survey.py"]


def test_only_the_builder_makes_predicates() -> None:
    found = {
        str(path.relative_to(ROOT)): lines
        for path, module in _modules()
        if (lines := [*_xpath_in(module), *_wrong_calls_in(module)]) or _makes_predicates(module)
    }
    assert found == {}


@pytest.mark.parametrize(
    "line",
    [
        "f\"type='{x}'\"",
        "\"starts-with(name, 'p01-')\"",
        "'desc/ros and not(desc/replay)'",
        "'true()'",
        'pylsl.resolve_byprop("source_id", x)',
        'pylsl.ContinuousResolver(pred="kind")',
        "pylsl.resolve_bypred(f'{x}')",
    ],
)
def test_a_predicate_elsewhere_would_be_found(line: str) -> None:
    module = ast.parse(f"x = {line}")
    assert [*_xpath_in(module), *_wrong_calls_in(module)]
