"""``python -m tests.nightly [--part NAME...] [--again] [--list [--json]] [--join]``."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.nightly.parts import ROOT, Part, read_parts
from tests.nightly.result import Result
from tests.nightly.runner import Version, run_part, version

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


INTERRUPTED = 130


def _arguments(parts: Sequence[Part], given: Sequence[str] | None) -> argparse.Namespace:
    arguments = argparse.ArgumentParser(
        prog="tests.nightly",
        description="Run everything that is neither unit nor check, in parts. A part that has"
        " ended for this commit is not run again.",
    )
    names = [part.name for part in parts]
    arguments.add_argument(
        "--part", nargs="+", choices=names, default=names, metavar="NAME", help="only these"
    )
    arguments.add_argument("--again", action="store_true", help="also what has ended before")
    arguments.add_argument("--list", action="store_true", help="only say which parts there are")
    arguments.add_argument("--json", action="store_true", help="with --list: the names, as JSON")
    arguments.add_argument("--join", action="store_true", help="only write the report")
    return arguments.parse_args(given)


def _run(parts: Sequence[Part], results: Path, seed: int, root: Path, *, again: bool) -> None:
    for part in parts:
        file = results / f"{part.name}.json"
        if file.exists() and not again:
            before = Result.read(file)
            # A skipped part may have on this computer what it lacked on another one.
            if before.state != "skipped":
                print(f"{part.name}: {before.state} before", flush=True)
                continue
        print(f"{part.name}: {part.does} ...", flush=True)
        result = run_part(part, results, seed, root)
        result.write(file)
        print(f"{part.name}: {_ending(result)}", flush=True)


def _ending(result: Result) -> str:
    if result.missing:
        return f"SKIPPED, needs {', '.join(result.missing)}"
    failed = f", {len(result.failures)} FAILED" if result.failures else ""
    skipped = f", {sum(result.skipped.values())} skipped" if result.skipped else ""
    return f"{result.state}{failed}{skipped}, {result.tests} tests, {result.seconds / 60:.1f} min"


def _write_report(parts: Sequence[Part], folder: Path, on: Version) -> dict[str, Result]:
    files = {part.name: folder / on.key / f"{part.name}.json" for part in parts}
    results = {name: Result.read(file) for name, file in files.items() if file.exists()}
    page = folder.with_suffix(".md")
    page.write_text(report(on, parts, results), encoding="utf-8")
    print(f"The report is {page}")
    return results


def main(given: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Run the parts that are asked for; exit code 1 if one of them failed or has not run."""
    parts = read_parts(root / "tests" / "nightly" / "parts.toml", root)
    asked = _arguments(parts, given)
    if asked.list:
        lines = [f"{part.name:<16}{part.does}" for part in parts]
        print(json.dumps([part.name for part in parts]) if asked.json else "\n".join(lines))
        return 0
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    folder, on = root / "build" / "nightly", version(root)
    chosen = [part for part in parts if part.name in asked.part]
    was_interrupted = False
    if not asked.join:
        try:
            _run(chosen, folder / on.key, on.seed, root, again=asked.again)
        except KeyboardInterrupt:
            print("Interrupted: what has ended is kept; run it again to go on.", flush=True)
            was_interrupted = True
    folder.mkdir(parents=True, exist_ok=True)
    results = _write_report(parts, folder, on)
    if was_interrupted:
        return INTERRUPTED
    return 0 if is_good(chosen, results) else 1


if __name__ == "__main__":
    sys.exit(main())
