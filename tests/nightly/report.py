"""Joins the results of the parts into one page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from tests.nightly.parts import Part
from tests.nightly.result import Result
from tests.nightly.runner import Version

LONGEST_PART_S = 30 * 60.0


def is_good(parts: Sequence[Part], results: dict[str, Result]) -> bool:
    """Return whether each part has run or was skipped, and none has failed."""
    return all(part.name in results and results[part.name].state != "failed" for part in parts)


def report(version: Version, parts: Sequence[Part], results: dict[str, Result]) -> str:
    """Return the page, in Markdown."""
    lines = [
        f"# Nightly of {version.commit[:12]}",
        "",
        f"{_verdict(parts, results)} Commit {version.commit}: {version.title}",
        *_changes(version),
        *_machines(results),
        "",
        "| part | result | tests | failed | skipped | minutes | what |",
        "| --- | --- | ---: | ---: | ---: | ---: | --- |",
        *(_row(part, results.get(part.name)) for part in parts),
        *_failures(results),
        *_skipped(results),
    ]
    return "\n".join(lines) + "\n"


def _verdict(parts: Sequence[Part], results: dict[str, Result]) -> str:
    states = [results[part.name].state if part.name in results else "not run" for part in parts]
    counts = {state: states.count(state) for state in ("failed", "not run", "skipped", "passed")}
    return ", ".join(f"{count} {state}" for state, count in counts.items() if count) + "."


def _changes(version: Version) -> Iterator[str]:
    if version.changed:
        yield ""
        yield "**The work tree had changes that are not in this commit:**"
        yield ""
        yield from (f"    {line}" for line in version.changed)


def _machines(results: dict[str, Result]) -> Iterator[str]:
    machines = {
        f"- {result.system}, Python {result.python}, {result.processors} processors"
        for result in results.values()
    }
    if machines:
        yield ""
        yield from sorted(machines)
        yield f"- first part began {min(result.began for result in results.values())}"
        yield f"- {_minutes(sum(result.seconds for result in results.values()))} minutes in all"


def _row(part: Part, result: Result | None) -> str:
    if result is None:
        return f"| {part.name} | **not run** | | | | | {part.does} |"
    if result.missing:
        return f"| {part.name} | **skipped** | | | | | {part.does} |"
    state = result.state if result.state == "passed" else f"**{result.state}**"
    longer = " (over 30: divide it)" if result.seconds > LONGEST_PART_S else ""
    figures = (
        f"{result.tests} | {len(result.failures)} | {sum(result.skipped.values())}"
        f" | {_minutes(result.seconds)}{longer}"
    )
    return f"| {part.name} | {state} | {figures} | {part.does} |"


def _failures(results: dict[str, Result]) -> Iterator[str]:
    if any(result.failures for result in results.values()):
        yield from ("", "## What failed")
    for result in results.values():
        for failure in result.failures:
            yield from ("", f"### {result.part}: `{failure.test}`", "")
            yield from (f"    {line}" for line in failure.lines)


def _skipped(results: dict[str, Result]) -> Iterator[str]:
    if any(result.skipped or result.missing for result in results.values()):
        yield from ("", "## What was skipped, and why", "")
    for result in results.values():
        if result.missing:
            missing = ", ".join(result.missing)
            yield (
                f"- {result.part}, the whole part: needs {missing}"
                " (the packages are in tests/system/packages.txt)"
            )
        for reason, tests in sorted(result.skipped.items()):
            yield f"- {result.part}, {tests} {'test' if tests == 1 else 'tests'}: {reason}"


def _minutes(seconds: float) -> str:
    return f"{seconds / 60:.1f}"
