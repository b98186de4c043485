"""The page captures a device: nothing is saved before it was seen and somebody has agreed."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page as Window
from playwright.sync_api import Route, expect

from biosensor_gateway.captures.draft import AGREED, CONSENT
from biosensor_gateway.captures.file import ENDING, read
from biosensor_gateway.captures.replay import replay
from biosensor_gateway.demo.virtual_devices import simulated_settings
from biosensor_gateway.devices.empatica_e4.simulator.e4 import SimulatedE4
from biosensor_gateway.page.routes import capture as route
from biosensor_gateway.page.session import Session
from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording
from biosensor_gateway.simulation.world import World
from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Server
from tests.page.test_whose import Page
from tests.rigs.kept_logging import kept_logging
from tests.rigs.polling import until
from tests.rigs.wristbands import LOCATED

STRAP = '[[device]]\nsensor = "polar_h10"\nunit = "A"\ndevice = "{}"\n'
HEADING = "Help us: capture a device"
BUTTON = "Help us: capture this device"
OpenWindow = Callable[..., Window]

expect.set_options(1000 * DEADLINE_S)


@pytest.fixture(autouse=True)
def restore_logging() -> Iterator[None]:
    with kept_logging():
        yield


@pytest.fixture
def page(tmp_path: Path) -> Generator[Page]:
    """A page whose settings name a virtual strap that is in reach."""
    (tmp_path / "state").mkdir()
    with simulated_settings(["polar_h10"]) as loaded:
        address = loaded.devices[0].model_dump()["device"]
        yield Page(tmp_path / "state", STRAP.format(address))


async def told(page: Page, method: str, path: str, **content: Any) -> tuple[int, Any]:
    return await page.answer(method, path, json.dumps(content).encode())


def files_in(folder: Path) -> list[Path]:
    return [*folder.rglob(f"*{ENDING}")]


async def captured(page: Page, **wanted: Any) -> dict[str, Any]:
    code, answer = await told(page, "POST", "capture", sensor="polar_h10", seconds=6.0, **wanted)
    assert code == 200, answer
    while True:
        _, view = await told(page, "GET", "capture")
        if view["phase"] not in {"connecting", "capturing"}:
            return view
        await asyncio.sleep(0.1)


async def test_what_was_shown_is_saved_with_the_consent_and_replayed(
    page: Page, tmp_path: Path
) -> None:
    _, before = await told(page, "GET", "capture")
    assert [(each["sensor"], each["unit"]) for each in before["devices"]] == [("polar_h10", "A")]
    view = await captured(page, unit="A")
    assert (view["phase"], view["problems"], view["consent"]) == ("ready", [], CONSENT)
    assert any("device: polar_h10" in line for line in view["lines"])
    assert view["packets"] > 10
    _, whole = await told(page, "GET", "capture/whole")
    folder = tmp_path / "new" / "captures"
    code, outcome = await told(
        page, "POST", "capture/save", agreed=True, folder=str(folder), note="all well"
    )
    (file,) = folder.glob(f"*{ENDING}")
    assert code == 200
    assert str(file) in outcome["sentence"]
    capture = read(file)
    assert [each.model_dump_json(exclude_defaults=True) for each in capture.events] == whole[1:]
    assert (capture.header.consent, capture.header.note) == (AGREED, "all well")
    assert (await asyncio.to_thread(replay, capture)).problems == []
    _, after = await told(page, "GET", "capture")
    assert (after["phase"], after["lines"]) == ("none", [])


@pytest.mark.parametrize("agreement", [{}, {"agreed": False}, {"agreed": "yes"}])
async def test_without_consent_nothing_is_saved(
    page: Page, tmp_path: Path, agreement: dict[str, Any]
) -> None:
    await captured(page, unit="A")
    code, _ = await told(page, "POST", "capture/save", folder=str(tmp_path), **agreement)
    assert code == 422
    assert files_in(tmp_path) == []
    code, _ = await told(page, "DELETE", "capture")
    assert code == 200
    code, _ = await told(page, "POST", "capture/save", folder=str(tmp_path), agreed=True)
    assert code == 404
    code, _ = await told(page, "GET", "capture/whole")
    assert code == 404


async def test_one_that_is_in_no_settings_can_be_captured_too(page: Page) -> None:
    address = page.devices()[0]["device"]
    page.settings.write_text("")
    view = await captured(page, settings={"device": address})
    assert (view["phase"], view["devices"]) == ("ready", [])


async def test_what_is_not_there_is_told_in_a_sentence(page: Page) -> None:
    view = await captured(page, settings={"device": "00:00:00:00:00:01"})
    assert view["phase"] == "failed"
    assert view["problem"]
    for wanted in ({"unit": "B"}, {"settings": {"device": 3}}):
        code, answer = await told(page, "POST", "capture", sensor="polar_h10", **wanted)
        assert code in {400, 404}
        assert answer["problem"]


async def test_the_agent_is_ended_for_it_only_if_somebody_says_so_and_is_started_again(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []

    def end(_folder: Path) -> None:
        done.append("ended")

    def start(_session: Session, *, virtual: bool) -> None:
        done.append(f"started, virtual: {virtual}")

    # Both are programs of their own; the test in a browser has the real ones.
    monkeypatch.setattr(route, "stop_agent", end)
    monkeypatch.setattr(route, "started", start)
    page.has_agent("P01")
    code, question = await told(page, "POST", "capture", sensor="polar_h10", unit="A")
    (choice,) = question["choices"]
    assert (code, done) == (409, [])
    await captured(page, unit="A", **choice["more"])
    await until(lambda: done == ["ended", "started, virtual: False"])


async def test_a_recording_keeps_its_agent(page: Page, tmp_path: Path) -> None:
    page.has_agent("P01")
    folder = RecorderFolder(page.session.folder)
    folder.path.mkdir()
    folder.save(SavedRecording(str(tmp_path / "one.xdf"), (), 1.0))
    lock = folder.try_lock()
    assert lock is not None
    code, answer = await told(page, "POST", "capture", sensor="polar_h10", unit="A", end_agent=True)
    lock.release()
    assert (code, answer["choices"]) == (409, [])
    _, view = await told(page, "GET", "capture")
    assert view["phase"] == "none"


@pytest.fixture
def wristband() -> Generator[SimulatedE4]:
    with World() as world, SimulatedE4(world, device_id="9ff167") as running:
        yield running


def _shorter(request: Route) -> None:
    content: Any = request.request.post_data_json
    if request.request.method == "POST":
        request.continue_(post_data=json.dumps(content | {"seconds": 5.0}))
    else:
        request.continue_()


@pytest.mark.nightly
def test_a_person_captures_a_device_that_streams_and_it_streams_again(
    server: Server, window: OpenWindow, wristband: SimulatedE4, tmp_path: Path
) -> None:
    server.programs.settings.write_text(LOCATED.format(**wristband.settings))
    page = window(color_scheme="light", viewport={"width": 420, "height": 900})
    page.route("**/api/v1/capture", _shorter)
    page.goto(server.address)
    page.get_by_role("button", name="Find sensors").first.click()
    entry = page.locator(".found li", has_text="9ff167")
    entry.get_by_role("button", name="Add").click()
    card = page.locator(".card", has_text="streaming")
    expect(card).to_have_count(1)
    card.get_by_role("button", name="Traces and details").click()
    page.get_by_role("button", name=BUTTON).click()
    panel = page.get_by_role("region", name=HEADING)
    panel.get_by_role("button", name="Capture it for a minute").click()
    page.get_by_role("button", name="End the agent, capture").click()
    expect(panel.get_by_text("listening to it")).to_be_visible()
    expect(panel.get_by_role("heading", name="What would leave this computer")).to_be_visible()
    shown = panel.locator("pre").first.inner_text()
    assert "device: empatica_e4" in shown
    assert "became" in shown
    panel.get_by_text("All of it, line by line").click()
    expect(panel.locator("pre").nth(1)).to_contain_text("opened")
    save = panel.get_by_role("button", name="Save the file")
    expect(save).to_be_disabled()
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert violations(page) == []
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    panel.get_by_label("Save to this folder").fill(str(tmp_path / "captures"))
    panel.get_by_label(AGREED).check()
    save.click()
    expect(panel.get_by_text("Nothing was sent")).to_be_visible()
    (file,) = (tmp_path / "captures").glob(f"*{ENDING}")
    content = read(file).model_dump_json()
    assert "9ff167" not in content.casefold()
    # Its exit code says whether there is a problem.
    server.programs.call("capture", "replay", str(file))
    panel.get_by_role("button", name="Close").click()
    expect(page.locator(".card", has_text="streaming")).to_have_count(1)


@pytest.mark.nightly
def test_who_has_set_up_nothing_finds_a_device_and_throws_its_capture_away(
    server: Server, window: OpenWindow, wristband: SimulatedE4, tmp_path: Path
) -> None:
    server.programs.settings.write_text(LOCATED.format(**wristband.settings))
    page = window()
    page.route("**/api/v1/capture", _shorter)
    page.goto(server.address)
    page.get_by_role("button", name="Find sensors").first.click()
    entry = page.locator(".found li", has_text="9ff167")
    entry.get_by_role("button", name=BUTTON).click()
    panel = page.get_by_role("region", name=HEADING)
    panel.get_by_role("button", name="Capture it for a minute").click()
    panel.get_by_role("button", name="Throw it away").click()
    expect(panel.get_by_role("button", name="Capture it for a minute")).to_be_visible()
    assert files_in(tmp_path) == []
