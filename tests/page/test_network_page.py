"""A person's way through the page of the network: real outlets, server and browser."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Generator
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.page.conftest import DEADLINE_S, Programs, Server
from tests.page.test_window import OpenWindow, violations

pytestmark = pytest.mark.nightly

NAME = "<img src=x onerror=alert(1)>\n\u202e"
SHOWN = "<img src=x onerror=alert(1)>\\n\\u202e"
OTHERS: list[dict[str, Any]] = [
    {"name": "amplifier", "rate": 20.0, "channels": 32},
    {"name": "holes", "rate": 100.0, "gap_every_s": 4.0, "gap_s": 1.0},
    {"name": "experiment", "type": "Markers", "format": "string", "text": "<b>trial {}</b>"},
    {"name": NAME, "rate": 50.0, "label": "<i>{}", "source_id": ""},
    {"name": "too much", "rate": 10_000.0, "channels": 64},
]
# Canvas colours are those of --gap, over nothing: red at a fifth.
IS_GAP_SHOWN = """canvas => {
  const { width, height } = canvas;
  const data = canvas.getContext("2d").getImageData(0, 0, width, height).data;
  for (let i = 0; i < data.length; i += 4) {
    if (data[i] > 160 && data[i + 1] < 90 && data[i + 3] > 30 && data[i + 3] < 90) return true;
  }
  return false;
}"""
TRACE = """name => {
  const live = window.biosensorLive;
  const trace = live.traces.get(name);
  if (!trace || trace.numbers.length < 60) return null;
  const rows = list => list.map(each => [...each]);
  return { bin: live.binS, numbers: trace.numbers, low: rows(trace.low), high: rows(trace.high) };
}"""
# A first measurement of the sender's clock on a busy computer may be wrong; the next one puts
# what is drawn from then on into its place.
IS_SPAN_RIGHT = """name => {
  const { binS, traces } = window.biosensorLive;
  const { numbers } = traces.get(name);
  const spanS = (numbers.at(-1) - numbers[0]) * binS;
  return numbers.length >= 60 && Math.abs(spanS - (numbers.length - 1) / 20) <= 0.1;
}"""


class Others:
    """Programs of others, each with outlets."""

    def __init__(self) -> None:
        self._running: list[subprocess.Popen[bytes]] = []

    def start(self, *streams: dict[str, Any]) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "tests.page.other_streams", json.dumps(streams)]
        self._running.append(subprocess.Popen(command, stdout=subprocess.DEVNULL))
        return self._running[-1]

    def end(self) -> None:
        for process in self._running:
            process.kill()
            process.wait(DEADLINE_S)


@pytest.fixture
def others() -> Generator[Others]:
    running = Others()
    yield running
    running.end()


@pytest.fixture
def network(programs: Programs) -> Server:
    return Server(programs, "--lsl")


def card(page: Page, title: str) -> Locator:
    return page.locator(f'.card[data-device="{title}"]')


def open_details(page: Page, title: str) -> None:
    card(page, title).get_by_role("button", name="Traces and details").click()


def test_from_nothing_to_ours_and_foreign_streams(
    network: Server, others: Others, window: OpenWindow
) -> None:
    page = window(viewport={"width": 1280, "height": 2000})
    page.on("dialog", lambda dialog: pytest.fail(dialog.message))
    page.goto(network.address)
    expect(page.get_by_role("heading", name="Streams on this network")).to_be_visible()
    expect(page.get_by_role("heading", name="No LSL stream is seen here yet")).to_be_visible()
    expect(page.get_by_text("biosensor-gateway doctor")).to_be_visible()

    network.programs.start("run", "--simulate", "zephyr")
    others.start(*OTHERS)
    expect(card(page, "Zephyr BioHarness 3")).to_contain_text("streaming")
    expect(card(page, "Zephyr BioHarness 3")).to_contain_text("lost 0")
    expect(card(page, "Capture agent")).to_contain_text("heartbeat")
    expect(card(page, "experiment")).to_contain_text("<b>trial ")
    expect(card(page, "too much")).to_contain_text("there, not received")
    expect(page.get_by_role("heading", name=SHOWN)).to_be_visible()
    assert page.locator("img, main b, main i").count() == 0
    holes = card(page, "holes").locator("canvas")
    page.wait_for_function(f"canvas => ({IS_GAP_SHOWN})(canvas)", arg=holes.element_handle())

    open_details(page, "Zephyr BioHarness 3")
    row = page.locator("tr", has_text="zephyr-virtual-ecg")
    expect(row).to_contain_text("of 250 Hz")
    expect(row.locator("code", has_text="/biosensors/zephyr/ecg")).to_be_visible()
    page.get_by_role("button", name="Back to all streams").click()

    # What is drawn is what was sent: each sample is its number, and 1000 more in each channel.
    open_details(page, "amplifier")
    page.get_by_label("Channels of EEG").select_option(label="25 to 32 of 32")
    key = page.wait_for_function(
        "() => [...window.biosensorLive.traces.keys()].find(each => each.endsWith(':24'))"
    ).json_value()
    # Samples that were placed before the sender's clock was known may share a place.
    page.wait_for_function(IS_SPAN_RIGHT, arg=key)
    trace = page.wait_for_function(TRACE, arg=key).json_value()
    assert trace["low"] == trace["high"]
    numbers = [row[0] - 24_000 for row in trace["low"]]
    assert numbers == [numbers[0] + i for i in range(len(numbers))]
    assert all(
        row == [number + 1000 * c for c in range(24, 32)]
        for row, number in zip(trace["low"], numbers, strict=True)
    )
    expect(page.locator("tr", has_text="amplifier")).to_contain_text("20.0 of 20 Hz")


def test_everybody_can_use_it_also_when_streams_end(
    network: Server, others: Others, window: OpenWindow
) -> None:
    process = others.start({"name": "comes back", "rate": 100.0})
    others.start(*OTHERS)
    page = window(color_scheme="light")
    page.goto(network.address)
    expect(card(page, "experiment")).to_contain_text("trial")
    expect(card(page, "comes back")).to_contain_text("streaming")
    process.kill()
    assert violations(page) == []
    _narrow(page)

    page.get_by_label("Only names with").fill("COMES")
    expect(page.locator(".card")).to_have_count(1)
    expect(card(page, "comes back")).to_contain_text("gone for")
    expect(card(page, "comes back").locator(".value")).to_have_text("\u2013")
    others.start({"name": "comes back", "rate": 100.0})
    page.emulate_media(color_scheme="dark")
    assert violations(page) == []
    expect(card(page, "comes back")).to_contain_text("streaming")
    page.get_by_role("button", name="Traces and details").focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="comes back")).to_be_focused()
    assert violations(page) == []
    _narrow(page)

    network.process.terminate()
    expect(page.get_by_role("alert")).to_contain_text("page --lsl")
    expect(page.locator(".plot")).to_have_count(0)


def _narrow(page: Page) -> None:
    """Nothing is lost beside the edge, at 400 pixels and at 200 %."""
    for width in (400, 320):
        page.set_viewport_size({"width": width, "height": 700})
        page.wait_for_function("() => document.documentElement.scrollWidth <= innerWidth")
    page.set_viewport_size({"width": 1280, "height": 900})
