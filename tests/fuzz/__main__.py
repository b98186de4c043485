"""``python -m tests.fuzz [--seconds N] [--seed N] [--blind] [TARGET...]``; ``--help`` says more."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.fuzz.campaign import Outcome, run
from tests.fuzz.contract import NAMES
from tests.fuzz.engine import has_atheris

FINDS = Path("build/fuzz")
DEFAULT_SECONDS = 60.0


def _arguments() -> argparse.Namespace:
    arguments = argparse.ArgumentParser(prog="tests.fuzz", description=__doc__)
    arguments.add_argument("targets", metavar="TARGET", nargs="*", help=f"of {', '.join(NAMES)}")
    arguments.add_argument("--seconds", type=float, default=DEFAULT_SECONDS, help="for all, in all")
    arguments.add_argument("--seed", type=int, default=0, help="of what is drawn; 0: another one")
    arguments.add_argument("--corpus", type=Path, help="what to begin with")
    arguments.add_argument("--finds", type=Path, default=FINDS, help="where finds and logs go")
    arguments.add_argument("--blind", action="store_true", help="hypothesis instead of atheris")
    given = arguments.parse_args()
    unknown = [name for name in given.targets if name not in NAMES and "." not in name]
    if unknown:
        arguments.error(f"no target {', '.join(unknown)}; there are {', '.join(NAMES)}")
    return given


def _line(outcome: Outcome) -> str:
    covered = "" if outcome.covered is None else f", {outcome.covered} places reached"
    figures = f"{outcome.executed} inputs in {outcome.seconds:.1f} s{covered}"
    if outcome.is_good:
        return f"{outcome.name}: {figures}"
    where = f"\n  input: {outcome.find}" if outcome.find else ""
    return f"FIND in {outcome.name} ({figures}): {outcome.reason}{where}"


def main() -> int:
    """Fuzz; exit code 1 if anything was found."""
    given = _arguments()
    engine = "hypothesis, blind" if given.blind or not has_atheris() else "atheris"
    names = list(given.targets) or list(NAMES)
    print(f"{len(names)} targets, {given.seconds:g} s in all, by {engine}", flush=True)
    outcomes: list[Outcome] = []
    campaign = run(
        names,
        given.seconds,
        given.finds,
        corpus=given.corpus,
        blind=given.blind,
        seed=given.seed,
    )
    for outcome in campaign:
        print(_line(outcome), flush=True)
        outcomes.append(outcome)
    finds = [outcome for outcome in outcomes if not outcome.is_good]
    print(f"{len(outcomes) - len(finds)} passed, {len(finds)} failed")
    return 1 if finds else 0


if __name__ == "__main__":
    sys.exit(main())
