"""What is not passed on as it came stands on the card, in the details and on the network's page."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Programs, Server
from tests.page.test_network_reading import other_streams
from tests.page.test_window import OpenWindow

pytestmark = pytest.mark.nightly

AGENT = "run --no-ask --features --simulate ble_heart_rate --fault repeat:90s@2s"
SKIN = {"name": "Skin", "type": "GSR", "rate": 100.0, "source_id": "electrodes", "unit": ""}
REPEATED = re.compile(r"ibi: \d+ samples were not sent: intervals between beats add up to more")
expect.set_options(1000 * DEADLINE_S)


def test_it_stands_where_a_person_looks(
    server: Server, window: Callable[..., Page], programs: Programs
) -> None:
    programs.start(*AGENT.split())
    with other_streams([SKIN]):
        page = window()
        page.goto(server.address)
        card = page.locator('.card[data-device^="ble_heart_rate"]')
        expect(card.locator(".refused")).to_contain_text(REPEATED)
        expect(card.locator(".card-head .state.warn")).to_contain_text("not all as it came")
        own = page.locator(".panel", has_text="Not all is passed on as it came")
        expect(own).to_contain_text("live features of Skin: stream 'Skin' has no unit")
        assert not violations(page)
        card.get_by_role("button", name="Traces and details").click()
        expect(page.locator(".panel .refused", has_text=REPEATED)).to_be_visible()
        assert "Skin" in programs.call("status")

        network = Server(programs, "--lsl")
        other = window()
        other.goto(network.address)
        seen = other.locator(".card", has_text="heart rate")
        expect(seen.locator(".note").first).to_contain_text(REPEATED)


# Live features on both pages: beside what they come from, and no stale value as one of now.
RATE = re.compile(r"^\d+(\.\d)? bpm$")
NOTHING = "\u2013"
# How far from its mark the largest value of the ECG around each beat is, in pixels; the beats that
# have a whole pulse of ECG on both sides.
OFFSETS = """([beats, ecg]) => {
  const { traces } = window.biosensorLive;
  const [marks, trace] = [traces.get(beats), traces.get(ecg)];
  if (!marks || !trace || marks.numbers.length < 5) return null;
  const around = marks.numbers.slice(1, -2).map((mark) => {
    const rows = trace.numbers.map((number, i) => [number, trace.high[i][0]]);
    const near = rows.filter(([number]) => Math.abs(number - mark) < 10);
    return near.length ? near.reduce((a, b) => (b[1] > a[1] ? b : a))[0] - mark : 99;
  });
  return around.length > 2 ? around : null;
}"""
# The colour of marks is that of text; traces have another one.
IS_MARKED = """canvas => {
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] > 200 && data[i] < 60 && data[i + 1] < 60 && data[i + 2] < 70) return true;
  }
  return false;
}"""


def value(page: Page, feature: str) -> Locator:
    return page.locator(f'[data-feature="{feature}"]')


def require_marks(page: Page, beats: str, ecg: str) -> None:
    """Each beat is marked where the ECG is highest, and the mark is drawn."""
    offsets = page.wait_for_function(OFFSETS, arg=[beats, ecg]).json_value()
    assert all(abs(each) <= 1 for each in offsets), offsets
    spark = page.locator(".card", has_text="Polar").locator(".sparks canvas").first
    page.wait_for_function(IS_MARKED, arg=spark.element_handle())


def told(page: Page, path: str) -> Any:
    return page.evaluate("path => fetch(path).then(answer => answer.json())", path)


@pytest.mark.skipif(sys.platform == "win32", reason="halts a program by a signal")
def test_features_are_shown_with_their_quality_marked_in_traces_and_never_stale(
    server: Server, window: OpenWindow
) -> None:
    server.programs.start("run", "--no-ask", "--simulate", "polar_h10")
    features = server.programs.start("features")
    network = Server(server.programs, "--lsl")
    of_agent, of_network = window(color_scheme="light"), window(color_scheme="light")
    of_agent.goto(server.address)
    of_network.goto(network.address)
    for page in (of_agent, of_network):
        expect(value(page, "hr_live")).to_have_text(RATE)
        expect(page.get_by_role("group", name="Live features")).to_contain_text("quality good")

    (device,) = told(of_agent, "/api/v1/status")["devices"]
    found = {each["data_name"]: each for each in device["features"]}
    streams = {each["data_name"]: each for each in device["streams"].values()}
    assert found["hr_live"]["topic"] == "/biosensors/polar_h10/hr_live"
    # The strap says a rate of its own.
    assert abs(found["hr_live"]["values"][0] - streams["hr"]["values"][0]) < 5
    # What the newest is each second, by the stream beside the rate.
    assert found["hr_state"]["topic"] == "/biosensors/polar_h10/hr_state"
    told_of = re.compile(r"^HR, mean of \d+ intervals$")
    expect(value(of_agent, "hr_live")).to_have_attribute("title", told_of)
    require_marks(of_agent, found["beats"]["source_id"], streams["ecg"]["source_id"])
    seen = told(of_network, "/api/v1/streams")["devices"]
    (device,) = (each for each in seen if each["title"] == "Polar H10")
    keys = {each["data_name"]: each["source_id"] for each in device["streams"]}
    require_marks(of_network, keys["beats"], keys["ecg"])
    assert violations(of_agent) == violations(of_network) == []

    of_agent.get_by_role("button", name="Traces and details").click()
    expect(of_agent.get_by_text("\u25bc beat, \u25bd artefact")).to_be_visible()
    expect(of_agent.locator("tr", has_text="polar_h10-virtual-beats")).to_contain_text(" s, no")
    assert violations(of_agent) == []

    # One that hangs keeps its streams open, and says nothing any more.
    os.kill(features.pid, signal.SIGSTOP)
    try:
        for page in (of_agent, of_network):
            expect(value(page, "hr_live")).to_have_text(NOTHING)
    finally:
        os.kill(features.pid, signal.SIGCONT)
    for page in (of_agent, of_network):
        expect(value(page, "hr_live")).to_have_text(RATE)
