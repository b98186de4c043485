"""What the page costs the agent, the computer and the person who waits for it."""

from __future__ import annotations

import json
import re
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

from benchmarks.agent_load import streaming_agent
from benchmarks.effort import Effort
from benchmarks.figures import Figure, Measurement, Target
from benchmarks.page_reader import read_in_place_of
from benchmarks.processes import Process, Processes
from tests.rigs.chromium import OPTIONS
from tests.rigs.turns import OF_A_LAB

_SETTLE_S = 5.0
_NOTE_CARDS = """
new MutationObserver(() => {
  if (document.querySelectorAll(".card").length >= %d) window.cardsCameMs ??= Date.now();
}).observe(document, { childList: true, subtree: true });
"""
ADDRESS = re.compile(r"http://\S+")
_WORSE, _CPU, _PICTURES, _UP_S = Target(1.1), Target(6.0), Target(20.0, at_least=True), Target(1.0)


@dataclass(frozen=True, slots=True)
class PageRound:
    """The agent without the page, then with it."""

    # without_ms, with_ms, undrawn_ms: p99 from a packet's arrival to the end of its push into LSL;
    # the last with a reader that gets what the browser gets and draws nothing, as where a browser
    # has a processor of its own to draw with.
    without_ms: float
    with_ms: float
    undrawn_ms: float
    # up_s, usable_s: from the command to a server that answers, and from there to the cards of all
    # devices.
    up_s: float
    usable_s: float
    # Processor time of the page's server, of one core, while a browser shows the cards.
    server_percent: float
    server_mb: float  # Resident, at the end.
    pictures_hz: float  # That the browser has drawn.


def measure(effort: Effort) -> Measurement:
    """Measure with the seven devices of a lab and the real browser."""
    with streaming_agent(sensors=OF_A_LAB) as (agent, processes), sync_playwright() as playwright:
        browser = playwright.chromium.launch(**OPTIONS)
        rounds = [_round(agent, processes, browser, effort) for _ in range(effort.rounds)]
        browser.close()
    return Measurement("the page", _figures(rounds), {"rounds": [asdict(each) for each in rounds]})


def _figures(rounds: Sequence[PageRound]) -> list[Figure]:
    drawn = [each.with_ms / each.without_ms for each in rounds]
    undrawn = [each.undrawn_ms / each.without_ms for each in rounds]

    def median(name: str) -> float:
        return statistics.median(getattr(each, name) for each in rounds)

    before = f"{median('without_ms'):.2f} ms without"
    return [
        Figure("arrival to push, p99, with the page", median("with_ms"), "ms", note=before),
        _multiple("the same, as a multiple", drawn),
        _multiple("the same multiple, read and not drawn", undrawn),
        Figure("CPU of the page's server", median("server_percent"), "%", _CPU, "of one core"),
        Figure("memory of the page's server", median("server_mb"), "MB", note="resident"),
        Figure("pictures in the browser", median("pictures_hz"), "Hz", _PICTURES),
        Figure("server answers after", median("up_s"), "s", _UP_S),
        Figure("page is usable after that", median("usable_s"), "s", _UP_S),
    ]


def _multiple(title: str, ratios: Sequence[float]) -> Figure:
    spread = f"{min(ratios):.2f} to {max(ratios):.2f} by round"
    return Figure(title, statistics.median(ratios), "", _WORSE, spread)


def _round(agent: Process, processes: Processes, browser: Browser, effort: Effort) -> PageRound:
    without_ms = _p99_ms(agent, effort.agent_s)
    begun_s = time.monotonic()
    server = processes.start("biosensor_gateway.cli", "page", "--no-open")
    found = ADDRESS.search(server.line())
    assert found is not None
    up_s = time.monotonic() - begun_s
    page = browser.new_page()
    # Playwright itself looks every half second only.
    page.add_init_script(_NOTE_CARDS % len(OF_A_LAB))
    opened_s = time.time()
    page.goto(found[0])
    page.locator(".card").nth(len(OF_A_LAB) - 1).wait_for()
    usable_s = page.evaluate("window.cardsCameMs") / 1000 - opened_s
    time.sleep(_SETTLE_S)
    cpu_s, pictures, begun_s = server.cpu_s, _pictures(page), time.monotonic()
    with_ms = _p99_ms(agent, effort.agent_s)
    elapsed_s = time.monotonic() - begun_s
    server_percent = 100 * (server.cpu_s - cpu_s) / elapsed_s
    # One picture more or less depends on when counting begins.
    pictures_hz = round((_pictures(page) - pictures) / elapsed_s, 1)
    with read_in_place_of(page):
        time.sleep(_SETTLE_S)
        undrawn_ms = _p99_ms(agent, effort.agent_s)
    measured = PageRound(
        without_ms=without_ms,
        with_ms=with_ms,
        undrawn_ms=undrawn_ms,
        up_s=up_s,
        usable_s=usable_s,
        server_percent=server_percent,
        server_mb=server.memory_mb,
        pictures_hz=pictures_hz,
    )
    server.stop()
    return measured


def _p99_ms(agent: Process, seconds: float) -> float:
    agent.tell()
    agent.expect("measuring")
    time.sleep(seconds)
    agent.tell()
    figures: dict[str, Any] = json.loads(agent.line())
    delays: list[float] = sorted(figures["delays_ms"])
    return delays[int(0.99 * len(delays))]


def _pictures(page: Page) -> int:
    return page.evaluate("window.biosensorLive.pictures")
