"""Runs checks in parallel, and formats their findings as text for people or JSON for scripts."""

from __future__ import annotations

import json
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from biosensor_common.doctor.check import Category, Check, Context, Finding, Level, warning
from biosensor_common.terminal import wrapped

FORMAT_VERSION = 1
"""Format version of the JSON."""

_UNKNOWN = "What it would have found is unknown."
_ON_A_BUSY_COMPUTER = 3
"""Factor of the time limits where several checks are late, because they then slow each other."""
_MARKS = {
    Level.OK: "[ok]     ",
    Level.NOTE: "[note]   ",
    Level.WARNING: "[warning]",
    Level.ERROR: "[ERROR]  ",
}
_INDENT = " " * 12


@dataclass(frozen=True, slots=True)
class Report:
    """All findings, in the order of the checks, and the total time."""

    checks: tuple[Check, ...]
    findings: tuple[Finding, ...]
    seconds: float

    @property
    def is_good(self) -> bool:
        """Whether there are no errors."""
        return all(finding.level is not Level.ERROR for finding in self.findings)

    @property
    def counts(self) -> dict[Level, int]:
        """Number of findings of each level."""
        counted = Counter(finding.level for finding in self.findings)
        return {level: counted[level] for level in Level}


def run_checks(checks: Sequence[Check], context: Context) -> Report:
    """Run checks in parallel, each with its time limit.

    A check that raises or exceeds its limit gets a finding about it, after the findings that it
    had until then. A check that hangs stays in a daemon thread until the program ends.
    """
    begun = time.monotonic()
    running = [_Running(check, context) for check in checks]
    late = [each for each in running if not each.has_ended(begun)]
    if len(late) > 1:
        for each in late:
            each.has_ended(begun, _ON_A_BUSY_COMPUTER)
    findings = [finding for each in running for finding in each.result()]
    return Report(tuple(checks), tuple(findings), time.monotonic() - begun)


class _Running:
    """A check that runs in a thread."""

    def __init__(self, check: Check, context: Context) -> None:
        self._check = check
        self._alone = context.guide.alone.format(check=check.name)
        self._findings: list[Finding] = []
        self._waited_s = 0.0
        self._thread = threading.Thread(
            target=self._run, args=(context,), name=f"doctor-{check.name}", daemon=True
        )
        self._thread.start()

    def has_ended(self, begun: float, times_as_long: int = 1) -> bool:
        """Wait for the check until its time limit; return whether it has ended."""
        self._waited_s = times_as_long * self._check.limit_s
        self._thread.join(max(0.0, begun + self._waited_s - time.monotonic()))
        return not self._thread.is_alive()

    def result(self) -> list[Finding]:
        """Return what the check has found so far."""
        is_late = self._thread.is_alive()
        found = self._findings.copy()
        if is_late:
            what = f"the check did not end within {self._waited_s:g} s"
            found.append(warning(what, _UNKNOWN, self._alone))
        return [self._check.mark(each) for each in found]

    def _run(self, context: Context) -> None:
        try:
            for finding in self._check.load()(context):
                self._findings.append(finding)
        except BaseException as problem:  # noqa: BLE001 - a check may fail in any way, also by sys.exit
            what = f"the check failed: {type(problem).__name__}: {problem}"
            self._findings.append(warning(what, _UNKNOWN, self._alone))


def as_json(report: Report) -> str:
    """Return the report as JSON, in ASCII."""
    return json.dumps(content(report), indent=2)


def content(report: Report) -> dict[str, Any]:
    """Return a report as a dictionary for JSON."""
    categories = {check.name: check.category.value for check in report.checks}
    return {
        "version": FORMAT_VERSION,
        "good": report.is_good,
        "seconds": round(report.seconds, 3),
        "checks": [check.name for check in report.checks],
        "counts": {level.value: count for level, count in report.counts.items()},
        "findings": [
            asdict(finding) | {"category": categories[finding.check]} for finding in report.findings
        ],
    }


def as_text(report: Report, encoding: str = "utf-8", width: int | None = None) -> str:
    """Return the report as text for a console of this encoding and width."""
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
                first, *rest = described(finding)
                yield f"  {_MARKS[finding.level]} {first}"
                yield from (f"{_INDENT}{line}" for line in rest)
            yield ""


def described(finding: Finding) -> Iterator[str]:
    """Yield the lines of a finding: what was found, why it matters, and the fix."""
    yield f"{finding.check}: {printable(finding.what)}"
    if finding.why:
        yield f"why: {printable(finding.why)}"
    for number, line in enumerate(finding.fix.splitlines()):
        yield f"{'     ' if number else 'fix: '}{printable(line)}"


def _summary(report: Report) -> str:
    counts = report.counts
    parts = [
        f"{counts[level]} {level.value}{'' if counts[level] == 1 else 's'}"
        for level in (Level.ERROR, Level.WARNING, Level.NOTE)
        if counts[level]
    ]
    checks = "1 check" if len(report.checks) == 1 else f"{len(report.checks)} checks"
    return f"{checks} in {report.seconds:.1f} s: {', '.join(parts) or 'no problem found'}"


def printable(text: str) -> str:
    """Remove control characters from foreign text, such as a stream's name, for the terminal."""
    return "".join(char if char.isprintable() else "?" for char in text)
