"""Quit: a person is asked what becomes of what goes on, and told how it ended."""

from __future__ import annotations

from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest
import pyxdf
from playwright.sync_api import Locator, Page, expect

from biosensor_gateway.agent.single_instance import is_held
from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Programs, Server
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

SETTINGS = """
[[device]]
sensor = "zephyr"
unit = "A"
port = "{port}"
participant = "p01"
"""

expect.set_options(1000 * DEADLINE_S)
OpenWindow = Callable[..., Page]


@pytest.fixture
def harness() -> Generator[SteeredBioHarness]:
    with SteeredBioHarness() as running:
        yield running


def quit_button(page: Page) -> Locator:
    return page.get_by_role("button", name="Quit")


def ended(page: Page) -> Locator:
    return page.get_by_role("heading", name="The page has ended")


def streaming(programs: Programs, page: Page) -> None:
    programs.start("run", "--simulate", "zephyr")
    expect(page.locator(".card", has_text="streaming")).to_have_count(1)


def test_nothing_goes_on_so_nobody_is_asked_and_every_window_says_that_it_ended(
    server: Server, window: OpenWindow
) -> None:
    page, other = window(), window()
    page.goto(server.address)
    found = server.programs.call("page", "--no-open").split()[-1]
    other.goto(found)
    quit_button(page).click()
    for each in (page, other):
        expect(ended(each)).to_be_visible()
        expect(each.get_by_text("You can close this window")).to_be_visible()
        assert violations(each) == []
    assert server.process.wait(DEADLINE_S) == 0


def test_the_page_alone_ends_and_the_agent_streams_on(server: Server, window: OpenWindow) -> None:
    page = window(viewport={"width": 400, "height": 700})
    page.goto(server.address)
    streaming(server.programs, page)
    quit_button(page).click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("The agent streams from one sensor")
    assert violations(page) == []
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)
    quit_button(page).click()
    dialog.get_by_role("button", name="Close only the page").click()
    expect(ended(page)).to_be_visible()
    expect(page.get_by_text("The agent streams on")).to_be_visible()
    assert server.process.wait(DEADLINE_S) == 0
    assert is_held(server.programs.folder)


@pytest.mark.seam
def test_everything_ends_and_the_recording_is_closed_first(
    server: Server, window: OpenWindow, harness: SteeredBioHarness, tmp_path: Path
) -> None:
    server.programs.settings.write_text(SETTINGS.format(port=harness.port))
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    expect(page.locator('[data-device="zephyr/A"]').get_by_text("streaming")).to_be_visible()
    session = page.get_by_role("region", name="Recording")
    session.get_by_label("Participant").fill("p01")
    session.get_by_label("Folder").fill(str(tmp_path / "recordings"))
    session.get_by_role("button", name="Record").click()
    expect(session.get_by_text("recording, all streams grow")).to_be_visible()
    quit_button(page).click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("A recording goes on")
    dialog.get_by_role("button", name="Close the recording and end everything").click()
    expect(ended(page)).to_be_visible()
    expect(page.get_by_text("The agent has ended.")).to_be_visible()
    assert server.process.wait(DEADLINE_S) == 0
    assert not is_held(server.programs.folder)
    (file,) = (tmp_path / "recordings").rglob("*.xdf")
    load: Any = vars(pyxdf)["load_xdf"]
    streams, _ = load(str(file))
    assert "p01-zephyr-A-ecg" in {each["info"]["name"][0] for each in streams}
