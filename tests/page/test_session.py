"""A session by the page alone: a recording with markers, a sensor that drops out, the verdict."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyxdf
from playwright.sync_api import Page, expect

from tests.page.conftest import DEADLINE_S, Server
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

DASH = "\N{EN DASH}"
SETTINGS = """
[markers]
buttons = ["baseline", "task"]

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


def recorded(folder: Path) -> dict[str, Any]:
    """Load the only recording below a folder; its streams by name."""
    (file,) = folder.rglob("*.xdf")
    load: Any = vars(pyxdf)["load_xdf"]
    streams, _ = load(file, synchronize_clocks=False, dejitter_timestamps=False)
    return {each["info"]["name"][0]: each for each in streams}


@pytest.mark.seam
def test_a_session_with_markers_and_a_sensor_that_drops_out(
    server: Server,
    window: Callable[..., Page],
    harness: SteeredBioHarness,
    tmp_path: Path,
) -> None:
    server.programs.settings.write_text(SETTINGS.format(port=harness.port))
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    card = page.locator('[data-device="zephyr/A"]')
    expect(card.get_by_text("streaming")).to_be_visible()

    session = page.get_by_role("region", name="Recording")
    session.get_by_label("Participant").fill("p01")
    session.get_by_label("Task").fill("handover")
    session.get_by_label("Folder").fill(str(tmp_path / "recordings"))
    session.get_by_role("button", name="Record").click()
    expect(session.get_by_text("recording, all streams are growing")).to_be_visible()

    markers = page.get_by_role("region", name="Markers")
    expect(page).to_have_title(f"● recording {DASH} Biosensor Gateway")
    markers.get_by_role("button", name="baseline").click()
    expect(markers.locator("li", has_text="baseline")).to_be_visible()
    markers.get_by_label("Note").fill("the robot 2 stopped")
    # In another view, the recording and the keys are there; Back leaves that view alone.
    card.get_by_role("button", name="Traces and details").click()
    bar = page.get_by_role("region", name="Current recording")
    expect(bar.get_by_text("● recording")).to_be_visible()
    page.keyboard.press("2")
    expect(page.locator(".toast")).to_have_text("Marked: task")
    page.go_back()
    expect(bar).to_have_count(0)
    expect(markers.locator("li", has_text="task")).to_be_visible()
    expect(markers.get_by_label("Note")).to_have_value("the robot 2 stopped")
    markers.get_by_role("button", name="Send note").click()
    entry = markers.locator("li", has_text="the robot 2 stopped")
    entry.get_by_role("button", name="undo").click()
    expect(entry.get_by_text("marked as a mistake")).to_be_visible()

    # A drop-out is red at once in the state, and within seconds for the recording.
    harness.drop_link()
    expect(session.get_by_text("something is wrong")).to_be_visible()
    expect(session.get_by_role("alert")).to_contain_text("p01's Zephyr BioHarness 3")
    expect(page).to_have_title(f"▲ recording: something is wrong {DASH} Biosensor Gateway")
    harness.restore_link()
    # What went wrong is over, and stays said.
    expect(session.get_by_text("recording, all streams are growing except")).to_be_visible()
    expect(session.get_by_text("p01-zephyr-A: 1 gap so far")).to_be_visible()

    session.get_by_role("button", name="Stop recording").click()
    expect(session.get_by_role("button", name="Record", exact=True)).to_be_visible()
    expect(session.locator(".verdict")).to_be_visible()

    streams = recorded(tmp_path / "recordings")
    told = [json.loads(text) for (text,) in streams[_markers(streams)]["time_series"]]
    said = [(each["marker"], each["kind"]) for each in told if each["kind"] != "ready"]
    assert [each for each in said if each[0] != "ready"] == [
        ("baseline", "button"),
        ("task", "button"),
        ("note", "note"),
        ("undo", "undo"),
    ]
    stamps = np.array(streams["p01-zephyr-A-ecg"]["time_stamps"])
    gaps = np.flatnonzero(np.diff(stamps) > 1)
    assert len(gaps) == 1


TYPES_AT_ONCE = """([participant, folder]) => {
  for (const [label, text] of [["Participant now", participant], ["Folder", folder]]) {
    const box = [...document.querySelectorAll("label")]
      .find((each) => each.textContent.startsWith(label)).querySelector("input");
    box.value = text;
    box.dispatchEvent(new InputEvent("input", { bubbles: true }));
  }
}"""


def test_what_is_typed_faster_than_the_page_is_drawn_stays(
    server: Server, window: Callable[..., Page], harness: SteeredBioHarness
) -> None:
    server.programs.settings.write_text(SETTINGS.format(port=harness.port))
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    session = page.get_by_role("region", name="Recording")
    # Prefilled with who wears the sensors; who types that once more changes nothing.
    expect(session.get_by_label("Participant")).to_have_value("p01")
    session.get_by_label("Participant").fill("p02")
    page.evaluate(TYPES_AT_ONCE, ["p01", "/somewhere"])
    page.wait_for_timeout(300)
    expect(session.get_by_label("Folder")).to_have_value("/somewhere")
    expect(session.get_by_label("Participant")).to_have_value("p01")


def _markers(streams: dict[str, Any]) -> str:
    (name,) = [each for each in streams if each.startswith("gateway-") and "markers" in each]
    return name


def test_what_cannot_be_recorded_is_said_and_nothing_is_written(
    server: Server, window: Callable[..., Page], tmp_path: Path
) -> None:
    server.programs.settings.write_text(SETTINGS.format(port="nowhere"))
    page = window()
    page.goto(server.address)
    session = page.get_by_role("region", name="Recording")
    session.get_by_label("Participant").fill("p01")
    for folder, sentence in (
        ("recordings", "is not a full path"),
        (str(tmp_path / "settings.toml"), "cannot make the folder"),
        (str(tmp_path / "recordings"), "no LSL stream, so"),
    ):
        session.get_by_label("Folder").fill(folder)
        session.get_by_role("button", name="Record").click()
        expect(page.locator(".toast")).to_contain_text(sentence)
    assert list(tmp_path.rglob("*.xdf")) == []


_KEEP_WHAT_THE_BAR_SAYS = """() => {
    window.said = [];
    const keep = () => window.said.push(document.querySelector(".bar").innerText);
    new MutationObserver(keep).observe(
        document.querySelector(".bar"), { subtree: true, childList: true, characterData: true });
}"""


def test_a_paused_sensor_is_asked_about_and_amber_in_every_view(
    server: Server, window: Callable[..., Page], harness: SteeredBioHarness, tmp_path: Path
) -> None:
    server.programs.settings.write_text(SETTINGS.format(port=harness.port))
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    card = page.locator('[data-device="zephyr/A"]')
    expect(card.get_by_text("streaming")).to_be_visible()
    expect(card.locator(".value", has_text="bpm")).to_be_visible()
    card.get_by_role("button", name="Traces and details").click()
    page.get_by_role("button", name="Pause (withdrawal)").click()
    expect(page.get_by_text("paused: nothing is sent since")).to_be_visible()
    page.go_back()
    for value in card.locator(".value").all():
        expect(value).to_have_text(DASH)
    expect(card.get_by_text(f"battery {DASH}")).to_be_visible()
    expect(card.get_by_text(f"lost {DASH}")).to_be_visible()

    # Another window, where the recording is only a bar above the traces.
    other = page.context.new_page()
    other.goto(page.url)
    other.locator('[data-device="zephyr/A"]').get_by_role("button").click()
    expect(other.get_by_role("region", name="Current recording")).to_contain_text("not recording")
    other.evaluate(_KEEP_WHAT_THE_BAR_SAYS)

    session = page.get_by_role("region", name="Recording")
    session.get_by_label("Folder").fill(str(tmp_path / "recordings"))
    session.get_by_role("button", name="Record", exact=True).click()
    question = page.get_by_role("dialog", name="A sensor does not stream")
    expect(question).to_contain_text("p01's Zephyr BioHarness 3 is paused since")
    question.get_by_role("button", name="Record without it").click()
    note = session.get_by_role("list", name="Other problems")
    expect(note).to_contain_text("p01's Zephyr BioHarness 3 is paused since")
    expect(page).to_have_title(f"◐ recording, look at it {DASH} Biosensor Gateway")
    expect(other.get_by_role("region", name="Current recording")).to_contain_text("is paused since")
    said = other.evaluate("window.said")
    opening = next(n for n, each in enumerate(said) if "Opening all streams" in each)
    assert not any("not recording" in each for each in said[opening:])
    other.close()

    bar = page.get_by_role("region", name="Current recording")
    toast = page.locator(".toast")
    views = ("Find sensors", "Play a recording", "Recordings", "Check this computer", "Help us")
    for number, name in enumerate(views):
        page.get_by_role("button", name=name).click()
        expect(bar).to_contain_text("p01's Zephyr BioHarness 3 is paused since")
        page.get_by_role("heading", level=2).first.click()
        page.keyboard.press(f"{number % 2 + 1}")
        expect(toast).to_have_text(f"Marked: {('baseline', 'task')[number % 2]}")
        page.get_by_role("button", name="Close").first.click()
        # What is below moves up, away from a click.
        expect(page.get_by_role("button", name="Close")).to_have_count(0)
    # Nor does a list from which something was chosen, which would choose what begins with 2.
    page.get_by_role("button", name="Play a recording").click()
    speed = page.get_by_label("Speed")
    speed.focus()
    page.keyboard.press("2")
    expect(toast).to_have_text("Marked: task")
    expect(speed).to_have_value("1")
    page.get_by_role("button", name="Close").first.click()
    # A box that was ticked has the focus and takes no digits; a field does.
    session.get_by_label("sound and notification").check()
    page.keyboard.press("2")
    expect(toast).to_have_text("Marked: task")
    page.get_by_label("Note").press("1")
    expect(page.get_by_label("Note")).to_have_value("1")
    expect(toast).to_have_text("Marked: task")
    page.set_viewport_size({"width": 400, "height": 300})
    card.scroll_into_view_if_needed()
    expect(bar.get_by_role("button", name="baseline")).to_be_visible()
    # Without the agent nobody can mark, which a key says as well as a button.
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="End the agent").click()
    expect(bar.get_by_role("button", name="baseline")).to_have_count(0)
    page.get_by_role("heading", level=1).click()
    page.keyboard.press("1")
    expect(toast).to_contain_text("agent")
    # Nothing is left to scroll to, and the panel is on the screen again.
    expect(card).to_have_count(0)
    session.get_by_role("button", name="Stop recording").click()
    verdict = session.locator(".verdict")
    expect(verdict).to_contain_text("zephyr/A of p01 was paused the whole time")
    # Neither a long state nor the verdict is wider than a narrow window.
    page.set_viewport_size({"width": 320, "height": 700})
    page.wait_for_function("() => document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.seam
def test_one_field_sets_the_sensors_and_the_file(
    server: Server, window: Callable[..., Page], harness: SteeredBioHarness, tmp_path: Path
) -> None:
    server.programs.settings.write_text(SETTINGS.format(port=harness.port))
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    card = page.locator('[data-device="zephyr/A"]')
    expect(card.get_by_text("streaming")).to_be_visible()

    # It is who wears the sensors, until another name is typed, which outlives other views.
    session = page.get_by_role("region", name="Recording")
    participant = session.get_by_label("Participant now")
    expect(participant).to_have_value("p01")
    session.get_by_label("Folder").fill(str(tmp_path / "recordings"))
    participant.fill("p02")
    card.get_by_role("button", name="Traces and details").click()
    page.get_by_role("button", name="Back to all devices").click()
    page.reload()
    expect(participant).to_have_value("p02")
    expect(session.get_by_text("The sensors are worn by p01.")).to_be_visible()

    session.get_by_role("button", name="Record", exact=True).click()
    question = page.get_by_role("dialog", name="Who wears the sensors?")
    expect(question).to_contain_text("The file is called p02, but its sensors are worn by p01.")
    question.get_by_role("button", name="Go back").click()
    expect(question).not_to_be_visible()
    assert list(tmp_path.rglob("*.xdf")) == []
    session.get_by_role("button", name="Record", exact=True).click()
    question.get_by_role("button", name="Set all sensors to p02, and record").click()
    expect(session.get_by_text("recording, all streams are growing")).to_be_visible()
    expect(page.get_by_role("heading", name="p02")).to_be_visible()

    # A change of the settings that costs the file a sensor is asked about.
    card.get_by_role("button", name="Traces and details").click()
    page.get_by_label("Participant (a pseudonym)").fill("p03")
    page.get_by_role("button", name="Save").click()
    going_on = page.get_by_role("dialog", name="A recording is running")
    going_on.get_by_role("button", name="Go back").click()

    page.get_by_role("button", name="Stop the recording").click()
    page.get_by_role("button", name="Back to all devices").click()
    expect(session.locator(".verdict")).to_be_visible()
    expect(session.get_by_text("but its sensors")).to_have_count(0)
    (file,) = (tmp_path / "recordings").rglob("*.xdf")
    assert file.name.startswith("sub-p02_")
    assert "p02-zephyr-A-ecg" in recorded(tmp_path / "recordings")


def test_a_card_stays_where_it_is_when_its_wearer_is_renamed(
    server: Server, window: Callable[..., Page], harness: SteeredBioHarness
) -> None:
    absent = SETTINGS.partition("[[device]]")[2].format(port="nowhere").replace('"A"', '"C"')
    both = f'{SETTINGS.format(port=harness.port)}\n[[device]]{absent}label = "back"\n'
    server.programs.settings.write_text(both)
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    cards = page.locator(".card")
    expect(cards).to_have_count(2)
    cards.first.get_by_role("button", name="Traces and details").click()
    page.get_by_label("Participant (a pseudonym)").fill("z9")
    page.get_by_role("button", name="Save").click()
    page.get_by_role("button", name="Back to all devices").click()
    expect(page.get_by_role("heading", name="z9")).to_be_visible()
    expect(cards).to_have_count(2)
    order = [each.get_attribute("data-device") for each in cards.all()]
    assert order == ["zephyr/A", "zephyr/C"]


NOTED = """
window.noticed = [];
window.Notification = class extends window.Notification {
  constructor(words, more) {
    super(words, more);
    window.noticed.push([words, more.body]);
  }
};
window.AudioContext = class extends window.AudioContext {
  constructor() {
    super();
    window.sounds = this;
  }
};
"""


def test_who_looks_elsewhere_hears_of_red_and_buttons_are_named_there(
    server: Server, window: Callable[..., Page], harness: SteeredBioHarness, tmp_path: Path
) -> None:
    server.programs.settings.write_text(SETTINGS.format(port=harness.port))
    page = window(permissions=["notifications"])
    page.add_init_script(NOTED)
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    expect(page.locator('[data-device="zephyr/A"]').get_by_text("streaming")).to_be_visible()
    session = page.get_by_role("region", name="Recording")
    markers = page.get_by_role("region", name="Markers")
    markers.get_by_role("button", name="Name the buttons").click()
    names = markers.get_by_role("textbox", name="Names of the buttons")
    expect(names).to_have_value("baseline\ntask")
    names.fill("baseline\nbaseline")
    markers.get_by_role("button", name="Save").click()
    expect(page.locator(".toast")).to_contain_text("markers.buttons")
    names.fill("rest, eyes closed\n\nhandover")
    markers.get_by_role("button", name="Save").click()
    expect(markers.get_by_role("button", name="handover")).to_be_visible()
    assert 'buttons = ["rest, eyes closed", "handover"]' in server.programs.settings.read_text()

    session.get_by_label("sound and notification").check()
    page.reload()
    expect(session.get_by_label("sound and notification")).to_be_checked()
    session.get_by_label("Folder").fill(str(tmp_path / "recordings"))
    session.get_by_role("button", name="Record", exact=True).click()
    expect(session.get_by_text("recording, all streams are growing")).to_be_visible()
    page.keyboard.press("2")
    expect(markers.locator("li", has_text="handover")).to_be_visible()
    assert page.evaluate("window.noticed") == []
    harness.drop_link()
    expect(page).to_have_title(f"▲ recording: something is wrong {DASH} Biosensor Gateway")
    page.wait_for_function("window.noticed.length")
    ((words, problem),) = page.evaluate("window.noticed")
    assert words == "▲ recording: something is wrong"
    assert problem
    assert page.evaluate("window.sounds.state") == "running"
