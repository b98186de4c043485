"""Every finding about a recording is explained, sorted by what it is about, and milder of us."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

import biosensor_gateway.recording
from biosensor_gateway.recording.recorder.request import RecorderReason
from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS
from biosensor_gateway.recording.xdf.findings import About, Finding, Level, in_order
from biosensor_gateway.recording.xdf.printing import as_json, as_text
from tests.xdf import xdf_file as made
from tests.xdf.checking import check

ROOM = Path(next(iter(biosensor_gateway.recording.__path__)))


def _codes(tree: ast.AST) -> Iterator[str]:
    """Give what stands behind a level, in a call of `Finding` or a tuple of a rule."""
    for node in ast.walk(tree):
        parts: list[ast.expr] = []
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "Finding":
            parts = node.args
        elif isinstance(node, ast.Tuple) and len(node.elts) == 3:
            parts = node.elts
        if len(parts) < 3 or not ast.unparse(parts[0]).lower().startswith("level"):
            continue
        if isinstance(parts[1], ast.Constant) and isinstance(parts[1].value, str):
            yield parts[1].value


def _all_codes() -> set[str]:
    return {
        code
        for path in ROOM.rglob("*.py")
        for code in _codes(ast.parse(path.read_text(encoding="utf-8")))
    }


def test_every_code_is_explained_and_every_explanation_is_of_a_code() -> None:
    found = _all_codes()
    assert len(found) > 40
    assert found - EXPLANATIONS.keys() - {each.value for each in RecorderReason} == set()
    assert EXPLANATIONS.keys() - found == set()


def test_findings_come_by_what_they_are_about_and_then_the_worst_first() -> None:
    findings = [
        Finding(Level.ERROR, "gaps", "a", "", About.OURSELVES),
        Finding(Level.NOTE, "gaps", "b", ""),
        Finding(Level.ERROR, "gaps", "c", "", About.OTHERS),
        Finding(Level.ERROR, "gaps", "d", ""),
    ]
    assert [each.stream for each in in_order(findings)] == ["d", "b", "c", "a"]


@pytest.mark.parametrize(
    ("level", "milder"),
    [(Level.ERROR, Level.WARNING), (Level.WARNING, Level.NOTE), (Level.NOTE, Level.NOTE)],
)
def test_what_we_record_of_ourselves_is_milder(level: Level, milder: Level) -> None:
    finding = Finding(level, "rate", "gateway/counters", "")
    assert finding.of(About.OURSELVES).level is milder
    assert finding.of(About.OTHERS).level is level


def test_the_report_says_what_findings_of_strangers_mean() -> None:
    header = made.stream_header(1, "theirs", rate=100.0, source_id="")
    stamps = [50.0 + each / 100 for each in range(300)]
    content = made.xdf(header, made.samples(1, "float32", [[1.0]] * 300, stamps))
    report = check(content)
    found = next(each for each in report.findings if each.code == "no-source-id")
    assert found.about is About.OTHERS
    told = {each["code"]: each for each in json.loads(as_json(report))["findings"]}
    assert told["no-source-id"]["about"] == "others"
    assert told["no-source-id"]["means"] == EXPLANATIONS["no-source-id"].means
    lines = as_text(report).splitlines()
    heading = lines.index("of other programs' streams:")
    assert heading > next(at for at, line in enumerate(lines) if "no stream has a footer" in line)
