"""Minimises the corpora, and takes over what reaches more: ``python -m tests.fuzz.grow``.

For each target, of its corpus, the seeds and what `python -m tests.fuzz` has grown, the
inputs are kept that reach a step of the code which no other one reaches. Regressions
(``find_``) and seeds that are meant to be odd (``odd_``) always stay.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from tests.fuzz.__main__ import FINDS
from tests.fuzz.contract import NAMES, Target, corpus_of, inputs, load, strictly
from tests.fuzz.engine import GROWN, GUIDES
from tests.fuzz.seeds import write_seeds

Step = tuple[str, int, int]
"""File, line before, line."""

_KEPT = ("find_", "odd_")
_GROWN = "grown_"
_DIGEST = 12
_LONGEST = 8192


def reached(target: Target, data: bytes) -> set[Step] | None:
    """Run the target; return the steps of the code under test, None if it is a find."""
    steps: set[Step] = set()
    before: dict[int, int] = {}

    def trace(frame: FrameType, event: str, _: object) -> Any:
        if event == "call" and frame.f_globals.get("__name__", "").split(".")[0] not in GUIDES:
            return None
        line = frame.f_lineno
        steps.add((frame.f_code.co_filename, before.get(id(frame), 0), line))
        before[id(frame)] = line
        return trace

    sys.settrace(trace)
    try:
        target.check(data)
    except Exception:  # noqa: BLE001 - finds have their own place
        return None
    finally:
        sys.settrace(None)
    return steps


def needed(target: Target, candidates: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the inputs that reach what none before them does."""
    seen: set[Step] = set()
    for data in candidates:
        steps = reached(target, data) if len(data) <= _LONGEST else None
        if steps is not None and not steps <= seen:
            seen |= steps
            yield data


def _grow(name: str, corpus: Path, seeds: Path, grown: Path) -> tuple[int, int]:
    """Replace a target's corpus; return how many inputs it had and has."""
    present = inputs(corpus)
    found = (path.read_bytes() for path in inputs(grown))
    titles = {data: f"{_GROWN}{hashlib.sha256(data).hexdigest()[:_DIGEST]}" for data in found}
    titles |= {path.read_bytes(): path.name for path in (*inputs(seeds), *present)}
    # What means something is better to begin with than what is merely short.
    ordered = sorted(titles, key=lambda data: (titles[data].startswith(_GROWN), len(data), data))
    odd = {name: data for data, name in titles.items() if name.startswith(_KEPT)}
    with strictly():
        kept = odd | {titles[data]: data for data in needed(load(name), ordered)}
    for path in present:
        if not path.name.startswith(_KEPT):
            path.unlink()
    for title, data in kept.items():
        (corpus / title).write_bytes(data)
    return len(present), len(inputs(corpus))


def main() -> None:
    """Grow the corpora of the named targets, or of all."""
    arguments = argparse.ArgumentParser(prog="tests.fuzz.grow")
    arguments.add_argument("targets", metavar="TARGET", nargs="*")
    arguments.add_argument("--finds", type=Path, default=FINDS, help="as of tests.fuzz")
    given = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        write_seeds(Path(folder))
        for name in given.targets or NAMES:
            corpus = corpus_of(name)
            corpus.mkdir(parents=True, exist_ok=True)
            grown = given.finds / name / GROWN
            before, after = _grow(name, corpus, Path(folder, name), grown)
            print(f"{name}: {before} inputs, now {after}", flush=True)


if __name__ == "__main__":
    main()
