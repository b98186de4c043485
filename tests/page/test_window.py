"""A person's way through the page, in a real browser, to its end by *Quit*."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, Literal, get_args

import psutil
import pytest
import pyxdf
from playwright.sync_api import Locator, Page, expect

from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.demo.virtual_devices import one_of_each
from biosensor_gateway.simulation.world import World
from tests.empatica_e4.steering import SteeredE4
from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Programs, Server
from tests.rigs.wristbands import LOCATED
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

# A person's way through the page, in a real browser with real programs behind it.

LEFT, RIGHT = "9ff167", "9ff168"
expect.set_options(1000 * DEADLINE_S)
OpenWindow = Callable[..., Page]
Scheme = Literal["light", "dark"]


@pytest.fixture
def wristbands() -> Generator[SteeredE4]:
    with World() as world, SteeredE4(world, device_id=LEFT, others=[RIGHT]) as running:
        yield running


def card(page: Page, unit: str) -> Locator:
    return page.locator(f'[data-device="empatica_e4/{unit.upper()}"]')


def picture(spark: Locator) -> str:
    return spark.evaluate("canvas => canvas.toDataURL()")


@pytest.mark.seam
def test_from_nothing_to_traces_of_virtual_sensors(server: Server, window: OpenWindow) -> None:
    page = window()
    page.goto(server.address)
    expect(page.get_by_role("heading", name="No sensor is set up yet")).to_be_visible()
    # Nothing is wrong with that.
    expect(page.locator("header .state")).to_have_class(re.compile("soft"))
    assert page.url == f"{server.origin}/"
    foot, file = page.locator("footer"), str(server.programs.settings)
    expect(foot).to_contain_text(f"Settings: {file}")
    page.get_by_role("button", name="Try it with virtual sensors").click()
    expect(page.get_by_text("These are virtual sensors")).to_be_visible()
    # A busy computer does not have all of them at once.
    expect(page.locator(".card")).to_have_count(len(one_of_each()))
    expect(
        page.locator(".card", has_text="streaming").first.locator("canvas").first
    ).to_be_visible()
    # Who changes them meanwhile has to know that nothing comes of it.
    expect(foot).to_contain_text(f"those of the settings are not used: {file}")
    page.get_by_role("button", name="End the agent").wait_for()
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="End the agent").click()
    expect(page.get_by_text("agent does not run")).to_be_visible()
    expect(page.locator(".card")).to_have_count(0)
    expect(foot).to_contain_text(f"Settings: {file}")


@pytest.mark.alone
def test_all_virtual_sensors_stream(server: Server, window: OpenWindow) -> None:
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Try it with virtual sensors").click()
    expect(page.locator(".card", has_text="streaming")).to_have_count(len(one_of_each()))


# A search where there is no Bluetooth is over before anybody could look.
WATCH_FOR_PROGRESS = """() => {
    const look = () => { window.progressSeen ||= document.querySelector("progress") !== null; };
    new MutationObserver(look).observe(document.body, { childList: true, subtree: true });
}"""


def test_two_sensors_are_found_added_watched_paused_renamed_and_removed(
    server: Server, window: OpenWindow, wristbands: SteeredE4
) -> None:
    server.programs.settings.write_text(LOCATED.format(**wristbands.settings))
    page = window()
    page.goto(server.address)
    page.evaluate(WATCH_FOR_PROGRESS)
    page.get_by_role("button", name="Find sensors").first.click()
    for unit, participant in ((LEFT, "p01"), (RIGHT, "p02")):
        entry = page.locator(".found li", has_text=unit)
        entry.get_by_label("Participant").fill(participant)
        entry.get_by_role("button", name="Add").click()
        expect(entry.get_by_text("one of your sensors")).to_be_visible()
    assert page.evaluate("window.progressSeen")
    page.get_by_role("button", name="Close").click()
    assert "# Where the server" in server.programs.settings.read_text()
    for unit, participant in ((LEFT, "p01"), (RIGHT, "p02")):
        expect(page.get_by_role("heading", name=participant)).to_be_visible()
        expect(card(page, unit).get_by_text("streaming")).to_be_visible()

    # Traces move.
    spark = card(page, LEFT).locator("canvas").first
    before = picture(spark)
    page.wait_for_function(
        "([canvas, before]) => canvas.toDataURL() !== before", arg=[spark.element_handle(), before]
    )

    # What the table says is what the wristband sent.
    card(page, LEFT).get_by_role("button", name="Traces and details").click()
    row = page.locator("tr", has_text=f"p01-empatica_e4-{LEFT.upper()}-gsr")
    expect(row.locator("td").first).to_contain_text("microsiemens")
    shown = float(row.locator("td").first.inner_text().split()[0])
    sent = [float(value) for value in wristbands.truth_of(LEFT).samples("gsr").values[:, 0]]
    assert min(abs(shown - value) for value in sent) < 0.01
    expect(row.locator("code", has_text="/p01/biosensors/empatica_e4/gsr")).to_be_visible()
    clock = page.get_by_label("Clock of the device")
    expect(clock).to_contain_text(re.compile(r"Drift\s*-?[\d.]+ ppm: it (loses|gains)"))
    expect(page.get_by_role("heading", name="Latest log entries")).to_be_visible()

    page.get_by_role("button", name="Pause").click()
    expect(page.get_by_text("paused: nothing is sent")).to_be_visible()
    page.get_by_role("button", name="Resume").click()
    expect(page.locator(".panel .state", has_text="streaming")).to_be_visible()

    page.get_by_label("Label").fill("left")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("was changed in the settings")).to_be_visible()
    expect(page.locator("code", has_text="empatica_e4__left").first).to_be_visible()
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Remove").click()
    expect(card(page, RIGHT).get_by_text("streaming")).to_be_visible()
    expect(card(page, LEFT)).to_have_count(0)
    view = page.evaluate("fetch('/api/v1/status').then(answer => answer.json())")
    (left,) = view["devices"]
    assert (left["unit"], left["connections"], left["lost"]) == (RIGHT.upper(), 1, 0)


def test_a_mistake_in_the_settings_is_explained_and_an_agent_that_dies_comes_back(
    server: Server, window: OpenWindow, wristbands: SteeredE4
) -> None:
    settings = server.programs.settings
    good = (
        LOCATED.format(**wristbands.settings)
        .replace("enabled = false", "")
        .replace('unit = "SERVER"\ndevice = "ffffff"', f'unit = "A"\ndevice = "{LEFT}"')
    )
    settings.write_text(good)
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    expect(card(page, "A").get_by_text("streaming")).to_be_visible()

    settings.write_text(good + 'prt = "x"\n')
    alert = page.get_by_role("alert")
    expect(alert).to_contain_text(re.compile(r"line 10.*prt", re.DOTALL))
    expect(card(page, "A").get_by_text("streaming")).to_be_visible()
    settings.write_text(good)
    expect(alert).to_have_count(0)

    # The log says of the wristband alone what has happened to it.
    page.get_by_role("button", name="Traces and details").click()
    wristbands.close_connections()
    log = page.get_by_role("region", name="Log of the device, the newest first")
    expect(log.locator("li", has_text="warning").first).to_be_visible()
    assert violations(page) == []
    page.get_by_role("button", name="Back to all devices").click()
    expect(card(page, "A").get_by_text("streaming")).to_be_visible()

    process = status_file.read_status(server.programs.folder)["process"]
    psutil.Process(process).send_signal(signal.SIGKILL)
    expect(page.get_by_text("The agent had died (killed by SIGKILL)")).to_be_visible()
    expect(card(page, "A").get_by_text("streaming")).to_be_visible()
    spark = card(page, "A").locator("canvas").first
    before = picture(spark)
    page.wait_for_function(
        "([canvas, before]) => canvas.toDataURL() !== before", arg=[spark.element_handle(), before]
    )


def test_a_server_that_has_ended_is_told_and_no_value_stays(
    server: Server, window: OpenWindow
) -> None:
    page = window()
    page.goto(server.address)
    server.programs.start("run", "--simulate", "zephyr")
    expect(page.locator(".card", has_text="streaming")).to_have_count(1)
    server.process.send_signal(signal.SIGINT)
    assert server.process.wait(DEADLINE_S) == 0
    expect(page.get_by_role("alert")).to_contain_text("The page's program does not answer")
    expect(page.locator(".card")).to_have_count(0)
    # The agent streams on.
    assert status_file.read_status(server.programs.folder)["devices"][0]["state"] == "streaming"


def test_foreign_text_is_shown_as_text(server: Server, window: OpenWindow) -> None:
    name = "<img src=x onerror=alert(1)>"
    server.programs.settings.write_text(
        f'[[device]]\nsensor = "zephyr"\nunit = "1"\nport = "nowhere"\nparticipant = "{name}"\n'
    )
    page = window()
    page.on("dialog", lambda dialog: pytest.fail(dialog.message))
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    expect(page.get_by_role("heading", name=name)).to_be_visible()
    assert page.locator("img").count() == 0


def violations_by_scheme(page: Page) -> list[Any]:
    found: list[Any] = []
    for scheme in get_args(Scheme):
        page.emulate_media(color_scheme=scheme)
        found += violations(page)
    return found


TOLD_OF_ITSELF = re.compile("^(bat|rssi)$")


def test_everybody_can_use_it(server: Server, window: OpenWindow) -> None:
    page = window()
    page.goto(server.address)
    expect(page.get_by_role("heading", name="No sensor is set up yet")).to_be_visible()
    assert violations_by_scheme(page) == []
    server.programs.start("run", "--simulate", "zephyr@p01,polar_h10@p02")
    expect(page.locator(".card", has_text="streaming")).to_have_count(2)
    assert violations_by_scheme(page) == []

    # In a wide window people are beside each other.
    page.set_viewport_size({"width": 1920, "height": 900})
    tops = page.locator(".card").evaluate_all(
        "all => all.map((e) => e.getBoundingClientRect().top)"
    )
    assert tops[0] == tops[1]

    # By the keyboard alone, to the details and back.
    button = page.get_by_role("button", name="Traces and details").first
    for _ in range(20):
        page.keyboard.press("Tab")
        if button.evaluate("button => button === document.activeElement"):
            break
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="Streams")).to_be_visible()
    assert violations_by_scheme(page) == []
    # What a device tells of itself has a row, and no empty plot.
    expect(page.locator("th", has_text=TOLD_OF_ITSELF).first).to_be_visible()
    expect(page.locator(".plot").first).to_be_visible()
    expect(page.locator(".plot strong", has_text=TOLD_OF_ITSELF)).to_have_count(0)
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    expect(page.locator(".card")).to_have_count(2)

    # Narrow, and at 200 %: nothing is lost beside the edge, nor where plots were wider before.
    for is_open in (False, True):
        if is_open:
            page.set_viewport_size({"width": 1280, "height": 700})
            button.click()
            expect(page.get_by_role("heading", name="Streams")).to_be_visible()
        for width in (640, 400, 320):
            page.set_viewport_size({"width": width, "height": 700})
            page.wait_for_function("() => document.documentElement.scrollWidth <= innerWidth")
            expect(page.get_by_role("button", name="Traces" if not is_open else "Back").first
                   ).to_be_visible()  # fmt: skip


MARKED = """
[markers]
buttons = ["task"]

[[device]]
sensor = "zephyr"
unit = "A"
port = "nowhere"
"""
OVERLAP = """() => {
  const own = document.querySelector(".toast").getBoundingClientRect();
  const buttons = [...document.querySelectorAll("[aria-labelledby=markers] .buttons button")];
  return buttons.map((each) => each.getBoundingClientRect()).some((box) =>
    own.left < box.right && box.left < own.right && own.top < box.bottom && box.top < own.bottom);
}"""


def test_what_came_of_something_covers_no_marker_button(server: Server, window: OpenWindow) -> None:
    server.programs.settings.write_text(MARKED)
    server.programs.start("run", "--no-ask")
    page = window()
    page.goto(server.address)
    button = page.get_by_role("region", name="Markers").get_by_role("button", name="task key")
    for width, height in ((1280, 800), (400, 800), (1280, 260), (400, 500)):
        page.set_viewport_size({"width": width, "height": height})
        button.click()
        expect(page.locator(".toast")).to_contain_text("Marked: task")
        page.wait_for_function(f"!({OVERLAP})()")


# Quit: a person is asked what becomes of what goes on, and told how it ended.
SETTINGS = """
[[device]]
sensor = "zephyr"
unit = "A"
port = "{port}"
participant = "p01"
"""
expect.set_options(1000 * DEADLINE_S)


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
    expect(page.get_by_text("The agent continues to stream")).to_be_visible()
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
    expect(session.get_by_text("recording, all streams are growing")).to_be_visible()
    quit_button(page).click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("A recording is running")
    dialog.get_by_role("button", name="Close the recording and end everything").click()
    expect(ended(page)).to_be_visible()
    expect(page.get_by_text("The agent has ended.")).to_be_visible()
    assert server.process.wait(DEADLINE_S) == 0
    assert not is_held(server.programs.folder)
    (file,) = (tmp_path / "recordings").rglob("*.xdf")
    load: Any = vars(pyxdf)["load_xdf"]
    streams, _ = load(str(file))
    assert "p01-zephyr-A-ecg" in {each["info"]["name"][0] for each in streams}
