"""Minimises the corpora, and takes over what reaches more: ``python -m tests.fuzz.grow``.

For each target, of its corpus, the seeds and what `python -m tests.fuzz` has grown, the
inputs are kept that reach a step of the code which no other one reaches. Regressions
(``find_``) and seeds that are meant to be odd (``odd_``) always stay.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import struct
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from tests.fuzz import text_seeds
from tests.fuzz.__main__ import FINDS
from tests.fuzz.contract import NAMES, SENSORS, Target, corpus_of, inputs, load, module_of, strictly
from tests.fuzz.engine import GROWN, GUIDES
from tests.fuzz.seeding import Seeds

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


# Makes the seeds of the corpora from the vectors and recordings of the repository.


def _features() -> Seeds:
    """The head is what `features` makes of it: type, unit and rate; each part is of a shape."""
    sound = {"ecg": (0, 0, 130), "ppg": (1, 0, 64), "rr": (2, 2, 0), "gsr": (3, 1, 8)}
    sound |= {"breath": (4, 0, 20), "acc": (5, 4, 50), "ecg_2000": (0, 0, 2000)}
    shapes = {"ecg": 4, "ppg": 2, "rr": 0, "gsr": 3, "breath": 3, "acc": 5, "ecg_2000": 4}
    for name, (kind, unit, rate) in sound.items():
        head, shape = struct.pack("<BBf", kind, unit, rate), shapes[name]
        beats = [struct.pack("<BBe", shape, 255, 1.0 + at / 2) for at in range(3)]
        yield name, head + b"".join(beats)
        odd = [(0, math.nan), (6, 1.0), (7, 1.0), (24, 1.0), (32, -1.0), (40, 0.5), (1, 9.0)]
        broken = [struct.pack("<BBe", each, 9, size) for each, size in odd]
        yield f"{name}_broken", head + beats[0] + broken[0].join(broken) + beats[1]
        yield f"{name}_flat", head + struct.pack("<BBe", 0, 255, 5.0)
    for name, rate in (("rate", math.nan), ("slow", 3.0), ("fast", 2001.0)):
        yield f"odd_{name}", struct.pack("<BBf", 0, 0, rate)
    yield "odd_unit", struct.pack("<BBf", 3, 5, 8.0)


def seeds() -> dict[str, Seeds]:
    """Return the seeds of each target, with their names."""
    of_sensors = {name: module_of(name).seeds() for name in SENSORS}
    return {"features": _features(), **of_sensors, **text_seeds.seeds()}


def write_seeds(folder: Path) -> None:
    """Write all seeds, a folder for each target."""
    for target, found in seeds().items():
        place = folder / target
        place.mkdir(parents=True, exist_ok=True)
        for name, data in found:
            (place / name).write_bytes(data)
