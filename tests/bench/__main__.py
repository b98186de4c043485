"""``python -m tests.bench [--quick] [--json FILE]``."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

from biosensor_gateway.logs import configure_logs
from biosensor_gateway.settings import LogSettings
from tests.bench import agent_load, decoder_speed, machine, parser_speed, report
from tests.bench.legs import LEGS, Round
from tests.bench.processes import BenchError


@dataclass(frozen=True, slots=True)
class Effort:
    """How long is measured."""

    rounds: int
    seconds: float
    agent_s: float
    passes: int


_FULL = Effort(rounds=3, seconds=15.0, agent_s=30.0, passes=15)
_QUICK = Effort(rounds=1, seconds=5.0, agent_s=10.0, passes=5)


def _measure_legs(effort: Effort) -> dict[str, list[Round]]:
    """Measure in rounds of a rotating order, so that a noisy minute hits every leg."""
    names = list(LEGS)
    rounds: dict[str, list[Round]] = {name: [] for name in names}
    for number in range(effort.rounds):
        first = number % len(names)
        for name in names[first:] + names[:first]:
            sys.stderr.write(f"round {number + 1} of {effort.rounds}: {name}\n")
            rounds[name].append(LEGS[name](effort.seconds))
    return rounds


def _run(effort: Effort) -> report.Run:
    load = machine.load()
    rounds = _measure_legs(effort)
    sys.stderr.write("the agent with every device\n")
    agent = agent_load.measure(effort.agent_s)
    sys.stderr.write("the decoders\n")
    parser = parser_speed.measure(effort.passes)
    decoders = decoder_speed.measure(effort.passes)
    loads = (load, machine.load())
    return report.Run(machine.facts(), loads, effort.seconds, rounds, agent, parser, decoders)


def main() -> None:
    """Measure, print and write; exit code 1 if a process failed, never for a missed target."""
    arguments = argparse.ArgumentParser(prog="tests.bench", description=__doc__)
    arguments.add_argument("--quick", action="store_true", help="half a minute instead of three")
    arguments.add_argument("--json", type=Path, default=Path("build/bench.json"), metavar="FILE")
    options = arguments.parse_args()
    configure_logs(LogSettings(level="error"), None)
    try:
        run = _run(_QUICK if options.quick else _FULL)
    except BenchError as error:
        raise SystemExit(str(error)) from error
    report.show(run)
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(report.as_json(run), indent=2) + "\n")


if __name__ == "__main__":
    main()
