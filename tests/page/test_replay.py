"""A recording played on the page: what is seen of it, who is told, and how it ends."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import pylsl
import pytest
from playwright.sync_api import expect

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.stream_header import PREFIX
from biosensor_gateway.page.routes.replay import MOST_LISTED, recordings, whole_path
from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Server
from tests.page.test_window import OpenWindow
from tests.replay import files

LONG_S = 600.0


@pytest.mark.nightly
def test_a_recording_is_played_marked_and_ended(
    server: Server, window: OpenWindow, tmp_path: Path
) -> None:
    recording = files.write(
        tmp_path / "study.xdf",
        files.regular(1, "sine[1]", 50.0, LONG_S, source_id="a"),
        files.regular(2, "other", 10.0, LONG_S, source_id="b"),
        files.texts(3, "marks", [0.5, 1.0], source_id="c"),
    )
    page = window()
    page.goto(server.address)
    page.get_by_role("banner").get_by_role("button", name="Play a recording").click()
    panel = page.get_by_role("region", name="Play a recording")
    panel.get_by_label("Recording").select_option("another file …")
    panel.get_by_label("whole path").fill("study.xdf")
    expect(panel.get_by_role("alert")).to_contain_text("not a whole path")
    panel.get_by_label("whole path").fill(str(recording))
    expect(panel.get_by_text("0:09:59 long, 3 streams")).to_be_visible()
    panel.get_by_text("Streams: all").click()
    panel.get_by_role("checkbox", name="other").uncheck()
    play = panel.get_by_role("button", name="Play", exact=True)
    panel.get_by_label("From").fill("1:00:00")
    play.click()
    expect(page.locator(".toast")).to_contain_text("has no samples in the selection")
    panel.get_by_label("From").fill("0:10")
    panel.get_by_label("Speed").select_option("2 times")
    play.click()

    notice = page.get_by_role("region", name="Replay: a recording, not a person")
    expect(notice).to_contain_text("study.xdf at 2 times its speed")
    card = page.locator(".card")
    expect(card).to_have_count(1)
    expect(card).to_contain_text("replay, not a person")
    spark = card.locator("canvas").element_handle()
    before = page.evaluate("canvas => canvas.toDataURL()", spark)
    page.wait_for_function("([canvas, was]) => canvas.toDataURL() !== was", arg=[spark, before])
    (found,) = pylsl.resolve_byprop("name", "sine[1]", timeout=DEADLINE_S)
    assert found.source_id().startswith(PREFIX)
    assert found.nominal_srate() == 100.0
    expect(notice).to_contain_text("of 2 streams received")
    assert violations(page) == []

    card.get_by_role("button", name="Traces and details").click()
    expect(page.get_by_text("nobody is measured now")).to_be_visible()
    expect(page.locator("tr", has_text="sine[1]")).to_contain_text("of 100 Hz")
    expect(page.get_by_role("button", name="Pause")).to_have_count(0)

    notice.get_by_role("button", name="End the replay").click()
    over = page.get_by_role("region", name="The replay has ended")
    expect(over).to_contain_text("samples were sent")
    expect(page.locator(".card")).to_have_count(0)
    over.get_by_role("button", name="Close").click()
    expect(over).to_have_count(0)
    page.reload()
    expect(page.get_by_role("heading", name="Biosensor Gateway")).to_be_visible()
    expect(over).to_have_count(0)


@pytest.mark.nightly
def test_a_replay_ends_with_the_page(server: Server, tmp_path: Path) -> None:
    recording = files.write(tmp_path / "a.xdf", files.regular(1, "alone", 4.0, LONG_S))
    cookie = server.enter()
    wanted = {"path": str(recording), "streams": ["alone"]}
    assert server.tell("POST", "replay/start", cookie, wanted).status == 200
    again = server.tell("POST", "replay/start", cookie, wanted)
    assert (again.status, b"being played already" in again.body) == (409, True)
    resolver = pylsl.ContinuousResolver(prop="name", value="alone", forget_after=1.0)
    until(lambda: bool(resolver.results()))
    server.process.terminate()
    server.process.wait(DEADLINE_S)
    until(lambda: not resolver.results())


def until(is_so: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_recordings_are_listed_the_newest_first(tmp_path: Path) -> None:
    inner = tmp_path / "sub-1" / "beh"
    inner.mkdir(parents=True)
    for age in range(MOST_LISTED + 3):
        file = inner / f"{age}.xdf"
        file.write_bytes(b"x")
        os.utime(file, (1e9 - age, 1e9 - age))
    (inner / "notes.txt").write_text("none")
    found = recordings([tmp_path, inner, tmp_path / "not there"])
    assert [each.name for each in found] == [f"{age}.xdf" for age in range(MOST_LISTED)]
    assert found[0].path == str(inner / "0.xdf")


def test_a_path_must_be_whole() -> None:
    with pytest.raises(ConfigError) as caught:
        whole_path("study.xdf")
    assert caught.value.reason is ConfigReason.WRONG_VALUE
