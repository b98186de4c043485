"""Recordings on the disk as a person sees them in the browser: judged, salvaged, exported."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.page.conftest import Programs, Server
from tests.recording_export.test_one_notion import RATE, SHAPES
from tests.xdf import xdf_file as made

pytestmark = pytest.mark.nightly

WHOLE = made.xdf(*SHAPES["even"])
HEADER = made.stream_header(1, "ecg", kind="ECG", rate=RATE, source_id="id1")
FILES = {
    "sub-P01_ses-1.xdf": WHOLE,
    "sub-P02_ses-1.xdf": made.xdf(*SHAPES["a gap"]),
    "game.xdf": made.xdf(*SHAPES["markers on a game's clock"]),
    "cut.xdf": WHOLE[: len(WHOLE) * 2 // 3],
    "lost.xdf": WHOLE.replace(HEADER, b""),
}


@pytest.fixture
def study(programs: Programs, tmp_path: Path) -> Path:
    """The user's folder of recordings."""
    programs.environment_more = {"HOME": str(tmp_path / "home"), "XDG_CONFIG_HOME": ""}
    folder = tmp_path / "home" / "Documents" / "Biosensor recordings"
    folder.mkdir(parents=True)
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    return folder


@pytest.fixture
def panel(study: Path, server: Server, window: Callable[..., Page]) -> Locator:
    assert study.exists()
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Recordings").first.click()
    return page.get_by_role("region", name="Recordings")


def _check(panel: Locator, name: str) -> None:
    panel.get_by_role("combobox", name=re.compile("^Recording")).select_option(label=name)
    panel.get_by_role("button", name="Check it").click()
    expect(panel.get_by_text(re.compile("^Markers: "))).to_be_visible()


def test_what_is_found_is_explained_where_it_stands_and_markers_have_times(panel: Locator) -> None:
    _check(panel, "sub-P02_ses-1.xdf")
    expect(panel.get_by_role("status").first).to_contain_text("◐ 2 streams, 24.0 s")
    gap = panel.get_by_text("ecg: 1 gap of 4.01 s in total, about 520 samples lost")
    expect(gap).to_be_visible()
    panel.get_by_text("What it means, and what to do").first.click()
    panel.get_by_text("Markers: 3").click()
    expect(panel.locator(".found-in-it li")).to_have_text(
        ["0:00:00 begin", "0:00:10 in the middle", "0:00:19 end"]
    )


def test_markers_before_the_start_have_a_minus(panel: Locator) -> None:
    _check(panel, "game.xdf")
    panel.get_by_text("Markers: 3").click()
    expect(panel.locator(".found-in-it li").first).to_have_text("\N{MINUS SIGN}0:16:39 begin")


def test_what_was_salvaged_can_be_chosen_at_once(panel: Locator) -> None:
    _check(panel, "cut.xdf")
    panel.get_by_role("button", name="Salvage it").click()
    expect(panel.get_by_text("choose it here and click")).to_be_visible()
    _check(panel, "cut_salvaged.xdf")
    expect(panel.get_by_role("status").first).to_contain_text("the file is intact")


def test_lost_headers_come_from_another_recording(panel: Locator, study: Path) -> None:
    _check(panel, "lost.xdf")
    panel.get_by_label(re.compile("^Headers from")).fill(str(study / "sub-P01_ses-1.xdf"))
    panel.get_by_role("button", name="Salvage it").click()
    expect(panel.get_by_text("stream ecg, samples kept 2600")).to_be_visible()


def test_a_folder_becomes_one_data_set(panel: Locator, study: Path, tmp_path: Path) -> None:
    for name in ("game.xdf", "cut.xdf", "lost.xdf"):
        (study / name).unlink()
    panel.get_by_role("combobox", name=re.compile("^Recording")).select_option(
        label="sub-P01_ses-1.xdf"
    )
    panel.get_by_label("BIDS").check()
    panel.get_by_label("all recordings in its folder").check()
    place = panel.get_by_label("Save to this folder")
    expect(place).to_have_attribute("placeholder", re.compile("^of one BIDS data set"))
    place.fill(str(tmp_path / "data set"))
    panel.get_by_role("button", name="Export").click()
    # With the tables that are chosen from the beginning it is none.
    expect(panel.get_by_role("alert")).to_contain_text("a data set can only hold BIDS")
    panel.get_by_label("CSV: tables").uncheck()
    panel.get_by_role("button", name="Export").click()
    expect(panel.get_by_text("Everything is exported")).to_be_visible()
    people = sorted(each.name for each in (tmp_path / "data set").glob("sub-*"))
    assert people == ["sub-P01", "sub-P02"]
