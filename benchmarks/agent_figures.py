"""The agent and its decoders, as figures."""

from __future__ import annotations

from dataclasses import asdict

from benchmarks import agent_load, decoder_speed, parser_speed
from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target

_CPU, _MEMORY, _P99_MS = Target(25.0), Target(150.0), Target(5.0)
_PARSER, _DECODER = Target(500.0, at_least=True), Target(200.0, at_least=True)
# Two hundred messages of text a second: the slowest once, so it is held to more.
_DECODERS = {"emotiv_insight": Target(1000.0, at_least=True)}


def measure_agent(effort: Effort) -> Measurement:
    """Measure the agent with a virtual device of every kind."""
    load = agent_load.measure(effort.agent_s)
    rate = f"of one core, {load.samples_a_second:.0f} samples/s"
    figures = [
        Figure("arrival to push, p50", load.p50_ms, "ms", note=f"{load.pushes} pushes"),
        Figure("arrival to push, p99", load.p99_ms, "ms", _P99_MS),
        Figure("CPU of the agent", load.cpu_percent, "%", _CPU, rate),
        Figure("memory of the agent", load.memory_mb, "MB", _MEMORY, "resident"),
    ]
    title = f"the agent with {len(agent_load.SENSORS)} devices"
    return Measurement(title, figures, asdict(load))


def measure_decoders(effort: Effort) -> Measurement:
    """Measure the BioHarness's decoder on real bytes, all on what virtual devices sent."""
    parsers = parser_speed.measure(effort.passes)
    decoders = decoder_speed.measure(effort.passes, effort.taped_s)
    figures = [
        Figure(
            f"BioHarness, {speed.recorded_s:.0f} s of a real one",
            speed.median,
            "x",
            _PARSER,
            f"best {speed.best:.0f}",
        )
        for speed in parsers
    ]
    figures += [
        Figure(
            speed.sensor,
            speed.median,
            "x",
            _DECODERS.get(speed.sensor, _DECODER),
            f"best {speed.best:.0f}",
        )
        for speed in decoders
    ]
    details = {
        "parser": [asdict(speed) for speed in parsers],
        "decoders": [asdict(speed) for speed in decoders],
    }
    return Measurement("decoders, times faster than real time", figures, details)
