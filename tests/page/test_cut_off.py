"""Of a recording that broke off, as on a full disk, verdict, file and *Salvage* stay there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import playwright.sync_api as browser
import pytest
from playwright.sync_api import expect

from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording
from biosensor_gateway.recording.xdf.findings import About
from biosensor_gateway.recording.xdf.verdict import check
from tests.page.conftest import Programs, Server
from tests.page.test_whose import Page
from tests.xdf import xdf_file as x

# The end is waited for, in real time.
pytestmark = pytest.mark.nightly

RATE, COUNT = 100, 400
WHOLE = x.xdf(
    x.stream_header(1, "ecg", rate=RATE),
    *(
        x.samples(1, "float32", [[1.0]] * RATE, [second + k / RATE for k in range(RATE)])
        for second in range(COUNT // RATE)
    ),
)


def given_up(folder: Path, content: bytes) -> Path:
    """Leave a recording that the recorder has given up; its file."""
    file = folder / "recordings" / "sub-P01_task-walk.xdf"
    file.parent.mkdir()
    file.write_bytes(content)
    kept = SavedRecording(
        str(file), ("ecg-id",), 1.0, ended=2.0, code=1, problem="LabRecorder's program ended"
    )
    memory = RecorderFolder(folder)
    memory.path.mkdir()
    memory.save(kept)
    return file


def ended(folder: Path, content: bytes) -> tuple[Page, Path]:
    file = given_up(folder, content)
    return Page(folder, ""), file


def verdict(page: Page) -> dict[str, Any]:
    found = page.session.recording.verdict
    assert found is not None
    return found.model_dump()


def test_what_broke_off_is_red_with_its_file_and_can_be_salvaged(tmp_path: Path) -> None:
    page, file = ended(tmp_path, WHOLE[:-20])
    code, answer = page.ask("POST", "recording/stop", {})
    shown = verdict(page)
    assert (code, answer["sentence"]) == (200, shown["sentence"])
    assert (shown["colour"], shown["file"], shown["salvaged"]) == ("red", str(file), "")
    assert shown["findings"][0].startswith("LabRecorder's program ended; it was not closed")
    assert any("the file breaks off at byte" in each for each in shown["findings"])
    assert str(tmp_path) not in " ".join(shown["findings"]), "others who look on read it"
    assert [each["text"] for each in shown["explained"]] == shown["findings"]
    subjects = [each["about"] for each in shown["explained"]]
    assert subjects == sorted(subjects, key=[each.value for each in About].index)
    assert all(each["means"] and each["to_do"] for each in shown["explained"])

    assert page.ask("POST", "recording/salvage", {})[0] == 200
    salvaged = Path(verdict(page)["salvaged"])
    assert salvaged.parent == file.parent
    assert sum(each.samples for each in check(salvaged).streams) == COUNT - RATE
    assert file.read_bytes() == WHOLE[:-20]
    assert verdict(page)["colour"] == "red", "what is lost stays lost"
    assert page.ask("POST", "recording/salvage", {})[0] == 404


def test_a_disk_that_is_full_from_the_begin_is_said(tmp_path: Path) -> None:
    page, file = ended(tmp_path, b"")
    assert page.ask("POST", "recording/stop", {})[0] == 200
    shown = verdict(page)
    assert (shown["colour"], shown["file"]) == ("red", str(file))
    assert shown["findings"] == ["LabRecorder's program ended; it is empty"]
    assert not shown["can_be_salvaged"]
    assert page.ask("POST", "recording/salvage", {})[0] == 404


def test_the_panel_explains_what_was_found(
    programs: Programs, window: Callable[..., browser.Page], tmp_path: Path
) -> None:
    programs.settings.write_text('[[device]]\nsensor = "polar_h10"\nunit = "STRAP"\n')
    given_up(tmp_path, WHOLE[:-20])
    page = window(viewport={"width": 1200, "height": 1000})
    page.goto(Server(programs).address)
    panel = page.get_by_role("region", name="Recording", exact=True)
    panel.get_by_role("button", name="Close and check it").click()
    expect(panel.get_by_role("heading", name="Data of persons")).to_be_visible()
    expect(panel.get_by_role("heading", name="Streams of other programs")).to_be_visible()
    found = panel.get_by_role("listitem").filter(has_text="the file breaks off")
    found.get_by_text("What it means, and what to do").click()
    expect(found).to_contain_text("Run xdf salvage and use")
    folder = panel.get_by_label("Folder")
    assert folder.evaluate("each => each.scrollWidth <= each.clientWidth")
