"""Prints findings as text for a person and as JSON for a script."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from biosensor_common.doctor.check import Category
from biosensor_common.doctor.finding import Finding, Level
from biosensor_common.doctor.runner import Report
from biosensor_common.terminal import wrapped

FORMAT_VERSION = 1

_MARKS = {
    Level.OK: "[ok]     ",
    Level.NOTE: "[note]   ",
    Level.WARNING: "[warning]",
    Level.ERROR: "[ERROR]  ",
}
_INDENT = " " * 12


def as_json(report: Report) -> str:
    """Return the report as JSON, in ASCII."""
    return json.dumps(content(report), indent=2)


def content(report: Report) -> dict[str, Any]:
    """Return what a script is told of a report."""
    categories = {check.name: check.category.value for check in report.checks}
    return {
        "version": FORMAT_VERSION,
        "good": report.is_good,
        "seconds": round(report.seconds, 3),
        "checks": [check.name for check in report.checks],
        "counts": {level.value: count for level, count in _counts(report).items()},
        "findings": [
            asdict(finding) | {"category": categories[finding.check]} for finding in report.findings
        ],
    }


def as_text(report: Report, encoding: str = "utf-8", width: int | None = None) -> str:
    """Return the report as lines that a console of that encoding, and width, can show."""
    lines = [*_lines(report), _summary(report)]
    text = "\n".join(wrapped(line, width, hang=len(_INDENT)) for line in lines)
    return text.encode(encoding, "replace").decode(encoding)


def _lines(report: Report) -> Iterator[str]:
    for category in Category:
        names = [check.name for check in report.checks if check.category is category]
        found = [finding for finding in report.findings if finding.check in names]
        if found:
            yield category.value
            for finding in found:
                yield from _finding_lines(finding)
            yield ""


def _finding_lines(finding: Finding) -> Iterator[str]:
    yield f"  {_MARKS[finding.level]} {finding.check}: {printable(finding.what)}"
    if finding.why:
        yield f"{_INDENT}why: {printable(finding.why)}"
    if finding.fix:
        first, *others = finding.fix.splitlines()
        yield f"{_INDENT}fix: {printable(first)}"
        yield from (f"{_INDENT}     {printable(line)}" for line in others)


def _summary(report: Report) -> str:
    counts = _counts(report)
    parts = [
        f"{counts[level]} {level.value}{'' if counts[level] == 1 else 's'}"
        for level in (Level.ERROR, Level.WARNING, Level.NOTE)
        if counts[level]
    ]
    checks = "1 check" if len(report.checks) == 1 else f"{len(report.checks)} checks"
    return f"{checks} in {report.seconds:.1f} s: {', '.join(parts) or 'no problem found'}"


def _counts(report: Report) -> dict[Level, int]:
    counted = Counter(finding.level for finding in report.findings)
    return {level: counted[level] for level in Level}


def printable(text: str) -> str:
    """Keep what a stranger wrote, such as a stream's name, from steering the terminal."""
    return "".join(char if char.isprintable() else "?" for char in text)
