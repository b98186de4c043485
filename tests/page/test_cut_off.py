"""Of a recording that broke off, as on a full disk, verdict, file and *Salvage* stay there."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import playwright.sync_api as browser
import psutil
import pytest
from playwright.sync_api import expect

from biosensor_gateway.recording.recorder.state import RecorderFolder, SavedRecording
from biosensor_gateway.recording.xdf.findings import About
from biosensor_gateway.recording.xdf.verdict import check
from tests.page.conftest import DEADLINE_S, Programs, Server
from tests.page.test_whose import Page
from tests.rigs.zephyr import SteeredBioHarness
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


@pytest.mark.parametrize("sensor", ["", '[[device]]\nsensor = "polar_h10"\nunit = "STRAP"\n'])
def test_the_panel_explains_what_was_found(
    programs: Programs, window: Callable[..., browser.Page], tmp_path: Path, sensor: str
) -> None:
    # Also if no sensor is set up, as after `run --simulate`, or where only others' streams are.
    programs.settings.write_text(sensor)
    given_up(tmp_path, WHOLE[:-20])
    page = window(viewport={"width": 1200, "height": 1000})
    page.goto(Server(programs).address)
    panel = page.get_by_role("region", name="Recording", exact=True)
    panel.get_by_role("button", name="Close and check it").click()
    expect(panel.get_by_role("heading", name="Participants' data")).to_be_visible()
    expect(panel.get_by_role("heading", name="Streams of other programs")).to_be_visible()
    found = panel.get_by_role("listitem").filter(has_text="the file breaks off")
    found.get_by_text("What it means, and what to do").click()
    expect(found).to_contain_text("Click Salvage it and use")
    folder = panel.get_by_label("Folder")
    assert folder.evaluate("each => each.scrollWidth <= each.clientWidth")


# A study of several people: each one's data has each one's name, in every file and at its end.

DEVICE = '[[device]]\nsensor = "zephyr"\nunit = "{}"\nport = "{}"\nlabel = "{}"\n'
RECORDED_S = 8.0
"""Until clock offsets are there."""


class Study:
    """Records by the page's interface, and looks at files by commands."""

    def __init__(self, server: Server, folder: Path) -> None:
        self._server, self._cookie = server, server.enter()
        self._folder = folder

    def tell(self, method: str, path: str, **content: Any) -> tuple[int, dict[str, Any]]:
        answer = self._server.tell(method, path, self._cookie, content)
        return answer.status, json.loads(answer.body)

    def status(self) -> dict[str, Any]:
        return json.loads(self._server.request("GET", "/api/v1/status", self._cookie).body)

    def start(self, participant: str, **more: bool) -> int:
        content = {"participant": participant, "folder": str(self._folder), **more}
        return self.tell("POST", "recording/start", **content)[0]

    def stop(self) -> dict[str, Any]:
        assert self.tell("POST", "recording/stop")[0] == 200
        return self.status()["recording"]["verdict"]

    def command(self, *arguments: str) -> tuple[int, str]:
        done = subprocess.run(
            [sys.executable, "-m", "biosensor_gateway.cli", *arguments],
            env=self._server.programs.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return done.returncode, done.stdout + done.stderr


@pytest.fixture
def study(server: Server, tmp_path: Path) -> Generator[Study]:
    with SteeredBioHarness() as first, SteeredBioHarness() as second:
        settings = server.programs.settings
        settings.write_text(
            DEVICE.format("A", first.port, "chest") + DEVICE.format("B", second.port, "back")
        )
        running = Study(server, tmp_path / "recordings")
        assert running.tell("POST", "agent/start")[0] == 200

        def stream() -> bool:
            return [each["state"] for each in running.status()["devices"]] == ["streaming"] * 2

        deadline = time.monotonic() + DEADLINE_S
        while not stream():
            assert time.monotonic() < deadline
            time.sleep(0.2)
        yield running


def test_each_has_its_own_name_and_a_wrong_one_is_never_green(study: Study) -> None:
    files: list[str] = []
    for name in ("P01", "P02", "P03"):
        assert study.tell("PUT", "participant", participant=name)[0] == 200
        assert study.start(name) == 200
        time.sleep(RECORDED_S)
        verdict = study.stop()
        assert verdict["colour"] != "red", verdict
        assert not any("called" in each for each in verdict["findings"])
        files.append(verdict["file"])
    # Whatever the settings are by now.
    for file in files:
        code, said = study.command("xdf", "check", file)
        assert code == 0, said

    # In a terminal, too.
    folder = str(Path(files[0]).parent)
    code, said = study.command("record", "start", "--here", "--folder", folder,
                               "--participant", "P09")  # fmt: skip
    assert code == 2
    assert "the file is called P09, but its sensors are worn by P03" in said
    assert study.start("P09") == 409
    assert study.start("P09", other_participants=True) == 200
    time.sleep(RECORDED_S)
    verdict = study.stop()
    assert verdict["colour"] == "red"
    assert verdict["findings"][0] == "the file is called P09, but its sensors are worn by P03"
    assert study.command("xdf", "check", verdict["file"])[0] == 1
    code, said = study.command("xdf", "export", verdict["file"], "--to", "bids")
    assert (code, "--whose" in said) == (1, True)
    dataset = Path(verdict["file"]).with_name("dataset")
    code, said = study.command("xdf", "export", verdict["file"], "--to", "bids", "--whose", "name",
                               "--output", str(dataset))  # fmt: skip
    assert code == 0, said
    assert [each.name for each in dataset.glob("sub-*")] == ["sub-P09"]


def test_what_is_renamed_or_removed_meanwhile_is_asked_about_and_red(study: Study) -> None:
    assert study.start("P01", set_sensors=True) == 200
    time.sleep(RECORDED_S)
    which = {"sensor": "zephyr", "unit": "A"}
    assert study.tell("PATCH", "devices", **which, participant="P02")[0] == 409
    assert study.tell("DELETE", "devices", **which)[0] == 409
    code, said = study.command("reload")
    assert (code, said) == (0, "nothing has changed for any device\n")
    confirmed = {"while_recording": True}
    assert study.tell("PATCH", "devices", **which, participant="P02", **confirmed)[0] == 200
    time.sleep(RECORDED_S)
    removed = {**confirmed, "sensor": "zephyr", "unit": "B"}
    assert study.tell("DELETE", "devices", **removed)[0] == 200
    time.sleep(RECORDED_S)
    verdict = study.stop()
    assert verdict["colour"] == "red"
    first, second, third = verdict["findings"][:3]
    assert first.startswith("zephyr/A of P01 was removed or renamed in the settings at ")
    assert second.startswith("zephyr/B of P01 was removed or renamed in the settings at ")
    assert "the agent also had P02@zephyr.chest, of which" in third


def test_a_recording_that_another_program_ends_has_a_verdict_of_its_own(
    study: Study, tmp_path: Path
) -> None:
    def shown(key: str) -> Any:
        deadline = time.monotonic() + DEADLINE_S
        while not (found := study.status()["recording"][key]):
            assert time.monotonic() < deadline, study.status()["recording"]
            time.sleep(0.2)
        return found

    assert study.start("P01", set_sensors=True) == 200
    first = study.stop()
    assert study.start("P01") == 200
    assert study.status()["recording"]["verdict"] is None
    code, said = study.command("record", "stop")
    assert code in {0, 1}, said
    second = shown("verdict")
    assert second["file"] != first["file"]
    assert second["file"] in said
    assert study.start("P01") == 200
    saved = RecorderFolder(tmp_path).saved()
    assert saved is not None
    psutil.Process(saved.program).kill()
    (problem,) = shown("problems")
    assert "ended" in problem
    assert study.status()["recording"]["verdict"] is None, "that of another file"
    assert study.stop()["file"] == saved.file
