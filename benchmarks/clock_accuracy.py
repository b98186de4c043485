"""How exact the stamps of simulated devices are: every drift, way and packet rate."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict

from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from tests.rigs import clock_simulation as simulation

RATES_HZ = (1, 4, 10, 50)
WAYS: Mapping[str, simulation.Way] = {
    "no delay": simulation.undelayed,
    "0 to 100 ms": simulation.uniform_100_ms,
    "bursts of 10": simulation.in_bursts,
    "1 % by 1 s": simulation.outliers_1_s,
}
IN_ORDER = "0 to 100 ms in order"
"""Differs from the other only where packets are less than 100 ms apart."""

STAMP_TARGETS: Mapping[int, Target] = {4: Target(3.0), 10: Target(1.0), 50: Target(1.0)}
SPACING_TARGET = Target(1.0)

Cell = tuple[int, str]
"""Packets a second, and the way's name."""


Rows = Mapping[Cell, simulation.Summary]


def measure(effort: Effort) -> Measurement:
    """Simulate the first minute of many devices."""
    begin_s, seeds = time.perf_counter(), effort.clock_seeds
    rows = {(rate, name): run(rate, way, seeds) for rate in RATES_HZ for name, way in WAYS.items()}
    in_order = {
        (RATES_HZ[-1], IN_ORDER): run(RATES_HZ[-1], simulation.uniform_100_ms_in_order, seeds)
    }
    figures = [_stamps(cell, row, STAMP_TARGETS.get(cell[0])) for cell, row in rows.items()]
    figures += [_stamps(cell, row, None) for cell, row in in_order.items()]
    figures += [_sample_spacing(rate, rows) for rate in RATES_HZ]
    figures += [_packet_spacing(cell, row) for cell, row in rows.items() if cell[0] == RATES_HZ[0]]
    details = {
        "drifts_ppm": simulation.DRIFTS_PPM,
        "seconds": time.perf_counter() - begin_s,
        "rows": {f"{rate}/s, {way}": asdict(row) for (rate, way), row in (rows | in_order).items()},
    }
    span = f"{simulation.SETTLED_S:g} to {simulation.END_S:g} s"
    return Measurement(f"simulated stamps, {span}", figures, details)


def run(rate_hz: int, way: simulation.Way, seeds: int) -> simulation.Summary:
    """Simulate every drift, each in so many courses; the same for the same arguments."""
    return simulation.summary(
        [
            simulation.simulate(rate_hz, way, drift_ppm, seed)
            for drift_ppm in simulation.DRIFTS_PPM
            for seed in range(seeds)
        ]
    )


def _stamps(cell: Cell, row: simulation.Summary, target: Target | None) -> Figure:
    note = (
        f"worst run {_ms(row.worst_stamp_rms_ms)}; nothing removed"
        f" {_ms(row.error_rms_ms)}, max {_ms(row.largest_error_ms)}"
    )
    return Figure(f"{cell[0]}/s, {cell[1]}: RMS", row.stamp_rms_ms, "ms", target, note)


def _sample_spacing(rate_hz: int, rows: Rows) -> Figure:
    worst = max(row.worst_sample_spacing_rms_ms for cell, row in rows.items() if cell[0] == rate_hz)
    title = f"{rate_hz}/s, spacing at {simulation.SIGNAL_HZ} Hz"
    return Figure(title, worst, "ms", SPACING_TARGET, "worst run of all ways")


def _packet_spacing(cell: Cell, row: simulation.Summary) -> Figure:
    note = f"one sample a packet; worst run {_ms(row.worst_packet_spacing_rms_ms)}"
    title = f"{cell[0]}/s, {cell[1]}: spacing"
    return Figure(title, row.packet_spacing_rms_ms, "ms", SPACING_TARGET, note)


def _ms(value: float) -> str:
    return f"{value:.3g}" if value >= 1.0 else f"{value:.2f}"
