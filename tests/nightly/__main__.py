"""``python -m tests.nightly [--part NAME...] [--again] [--list [--json]] [--join]``."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.nightly.parts import ROOT, Part, read_parts
from tests.nightly.report import is_good, report
from tests.nightly.result import Result
from tests.nightly.runner import Version, run_part, version

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
