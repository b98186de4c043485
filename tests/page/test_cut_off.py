"""Of a recording that broke off, as on a full disk, verdict, file and *Salvage* stay there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording
from biosensor_gateway.recording.xdf.verdict import check
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


def ended(folder: Path, content: bytes) -> tuple[Page, Path]:
    """A page, and a recording that the recorder has given up."""
    file = folder / "recordings" / "sub-P01_task-walk.xdf"
    file.parent.mkdir()
    file.write_bytes(content)
    kept = SavedRecording(
        str(file), ("ecg-id",), 1.0, ended=2.0, code=1, problem="LabRecorder's program ended"
    )
    memory = RecorderFolder(folder)
    memory.path.mkdir()
    memory.save(kept)
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
