"""Whether the page grows while it is open: its server, and what its scripts keep in the browser."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from playwright.sync_api import Page, sync_playwright

from benchmarks import growth, slope
from benchmarks.agent_load import SENSORS, streaming_agent
from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement
from benchmarks.page import ADDRESS
from tests.rigs.chromium import OPTIONS

_PERIOD_S, _PER_GROUP = 5.0, 6


def measure(effort: Effort) -> Measurement:
    """Watch both with a virtual device of every kind, all cards in view.

    Raises
    ------
    BenchError
        If a process failed.
    """
    groups: list[list[growth.State]] = []
    heap: list[tuple[float, float]] = []
    with streaming_agent() as (_, processes), sync_playwright() as playwright:
        server = processes.start("biosensor_gateway.cli", "page", "--no-open")
        found = ADDRESS.search(server.line())
        assert found is not None
        browser = playwright.chromium.launch(**OPTIONS)
        page = browser.new_page()
        page.goto(found[0])
        page.locator(".card").nth(len(SENSORS) - 1).wait_for()
        # Its answers have no types.
        tools: Any = page.context.new_cdp_session(page)
        tools.send("Performance.enable")
        begin_s = time.monotonic()
        while len(groups) < effort.page_s / _PERIOD_S / _PER_GROUP:
            group: list[growth.State] = []
            for _ in range(_PER_GROUP):
                page.wait_for_timeout(1000 * _PERIOD_S)
                group.append(growth.state(server, time.monotonic() - begin_s))
            groups.append(group)
            heap.append((time.monotonic() - begin_s, _kept_mb(page, tools)))
            sys.stderr.write(f"  {time.monotonic() - begin_s:.0f} of {effort.page_s:.0f} s\n")
        browser.close()
        server.stop()
    measured = growth.measurement("the page that stays open", groups, lambda group: group[-1])
    return replace(
        measured,
        figures=[*measured.figures, _heap_slope(heap)],
        details={**measured.details, "heap_mb": heap},
    )


def _kept_mb(page: Page, tools: Any) -> float:
    """Return what is left when the browser has thrown away all that nobody can reach."""
    tools.send("HeapProfiler.collectGarbage")
    page.wait_for_timeout(100)
    metrics: list[dict[str, Any]] = tools.send("Performance.getMetrics")["metrics"]
    (used,) = (each["value"] for each in metrics if each["name"] == "JSHeapUsedSize")
    return float(used) / 1e6


def _heap_slope(heap: Sequence[tuple[float, float]]) -> Figure:
    counted = heap[len(heap) // 2 :]
    line = slope.fit([time_s / 3600 for time_s, _ in counted], [mb for _, mb in counted])
    interval = (
        f"95 % interval {line.low:.2f} to {line.high:.2f}, {counted[-1][1]:.1f} MB at the end"
    )
    return Figure("slope of what its scripts keep", line.value, "MB/h", note=interval)
