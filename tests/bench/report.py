"""Figures of one run, as a table and as JSON."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from tests.bench.agent_load import AgentLoad
from tests.bench.decoder_speed import DecoderSpeed
from tests.bench.legs import Round
from tests.bench.parser_speed import ParserSpeed

RATIO_TARGET = 1.5
PARSER_TARGET = 500.0
DECODER_TARGET = 200.0
AGENT_CPU_TARGET, AGENT_MEMORY_TARGET, AGENT_P99_TARGET = 25.0, 150.0, 5.0

_TITLES = {
    "lsl": "LSL: push to pull_sample",
    "dds": "DDS: publish to callback",
    "node": "lsl_to_ros: push to callback",
}


@dataclass(frozen=True, slots=True)
class Run:
    """All that one run measured.

    Attributes
    ----------
    rounds
        By leg, in the order of time.
    load
        Load average at start and end.
    """

    machine: Mapping[str, str]
    load: tuple[float, float]
    seconds: float
    rounds: Mapping[str, Sequence[Round]]
    agent: AgentLoad
    parser: Sequence[ParserSpeed]
    decoders: Sequence[DecoderSpeed]

    def median(self, leg: str, figure: str) -> float:
        """Return the median over a leg's rounds."""
        return statistics.median(getattr(each, figure) for each in self.rounds[leg])

    @property
    def ratios(self) -> list[float]:
        """Median latency of the node, as a multiple of the floors' sum; one a round."""
        legs = zip(self.rounds["lsl"], self.rounds["dds"], self.rounds["node"], strict=True)
        return [node.p50_ms / (lsl.p50_ms + dds.p50_ms) for lsl, dds, node in legs]

    @property
    def ratio(self) -> float:
        """Median of the rounds' ratios: other load is alike within a round, not over a run."""
        return statistics.median(self.ratios)

    @property
    def slowest_parser(self) -> float:
        """Median speed on the recording that takes longer."""
        return min(speed.median for speed in self.parser)


def as_json(run: Run) -> dict[str, Any]:
    """Return everything, ready for :func:`json.dumps`."""
    return {
        **asdict(run),
        "ratio": {"value": run.ratio, "rounds": run.ratios, "target": RATIO_TARGET},
        "parser_target": PARSER_TARGET,
        "decoder_target": DECODER_TARGET,
        "agent_targets": {
            "cpu_percent": AGENT_CPU_TARGET,
            "memory_mb": AGENT_MEMORY_TARGET,
            "p99_ms": AGENT_P99_TARGET,
        },
    }


def show(run: Run) -> None:
    """Print one table and the conditions of the run."""
    table = Table(title="8 channels of float32 at 256 Hz, every role a process", box=SIMPLE_HEAD)
    table.add_column(f"medians of {len(run.ratios)} x {run.seconds:g} s")
    table.add_column("p50", justify="right")
    table.add_column("p99", justify="right")
    table.add_column("", no_wrap=True)
    for leg in run.rounds:
        _add_leg(table, run, leg)
    span = f"{min(run.ratios):.2f} to {max(run.ratios):.2f} by round"
    table.add_row("lsl_to_ros / (LSL + DDS)", f"{run.ratio:.2f}", "", span)
    table.add_row("", "", "", _verdict(f"<= {RATIO_TARGET}", reached=run.ratio <= RATIO_TARGET))
    cpu = run.median("node", "node_cpu_percent")
    table.add_row("CPU of lsl_to_ros", f"{cpu:.1f} %", "", "of one core")
    _add_agent(table, run.agent)
    for speed in run.parser:
        title = f"BioHarness decoder, {speed.recorded_s:.0f} s"
        best = f"x real time, best {speed.best:.0f}"
        table.add_row(title, f"{speed.median:.0f}", "", best)
    reached = run.slowest_parser >= PARSER_TARGET
    table.add_row("", "", "", _verdict(f">= {PARSER_TARGET:.0f}", reached=reached))
    _add_decoders(table, run.decoders)
    console = Console(highlight=False)
    console.print(table)
    console.print(", ".join(f"{key} {value}" for key, value in run.machine.items()))
    console.print(f"load average {run.load[0]} at the start, {run.load[1]} at the end")


def _add_leg(table: Table, run: Run, leg: str) -> None:
    lost, sent = sum(r.lost for r in run.rounds[leg]), sum(r.sent for r in run.rounds[leg])
    p50, p99 = run.median(leg, "p50_ms"), run.median(leg, "p99_ms")
    table.add_row(_TITLES[leg], f"{p50:.3f} ms", f"{p99:.3f} ms", f"{lost} of {sent} lost")


def _add_agent(table: Table, agent: AgentLoad) -> None:
    p50, p99 = f"{agent.p50_ms:.3f} ms", f"{agent.p99_ms:.3f} ms"
    table.add_row("agent, 7 devices: arrival to push", p50, p99, f"{agent.pushes} pushes")
    _add_verdict(table, agent.p99_ms, AGENT_P99_TARGET, "ms")
    rate = f"of one core, {agent.samples_a_second:.0f} samples/s"
    table.add_row("CPU of the agent", f"{agent.cpu_percent:.1f} %", "", rate)
    _add_verdict(table, agent.cpu_percent, AGENT_CPU_TARGET, "%")
    table.add_row("memory of the agent", f"{agent.memory_mb:.0f} MB", "", "resident")
    _add_verdict(table, agent.memory_mb, AGENT_MEMORY_TARGET, "MB")


def _add_decoders(table: Table, decoders: Sequence[DecoderSpeed]) -> None:
    for speed in decoders:
        best = f"x real time, best {speed.best:.0f}"
        table.add_row(f"decoder of {speed.sensor}", f"{speed.median:.0f}", "", best)
    reached = min(speed.median for speed in decoders) >= DECODER_TARGET
    table.add_row("", "", "", _verdict(f">= {DECODER_TARGET:.0f}", reached=reached))


def _add_verdict(table: Table, value: float, target: float, unit: str) -> None:
    table.add_row("", "", "", _verdict(f"<= {target:g} {unit}", reached=value <= target))


def _verdict(target: str, *, reached: bool) -> str:
    return f"target {target} {'reached' if reached else 'missed'}"
