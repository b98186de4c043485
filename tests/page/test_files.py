"""Recordings on the disk, from the page: judged, salvaged, exported, with every reason."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

import biosensor_gateway.page
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.page.advice import clicked
from biosensor_gateway.page.models import all_explained
from biosensor_gateway.page.routes import files as page_files
from biosensor_gateway.page.share import view_of
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export import job
from biosensor_gateway.recording.recorder.presence import Presence, require_startable
from biosensor_gateway.recording.recorder.request import (
    BidsLabels,
    RecorderError,
    RecordingRequest,
    VisibleStream,
)
from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS
from biosensor_gateway.recording.xdf.findings import Finding, Level
from tests.page.test_whose import Page
from tests.recording_export import odd_shapes
from tests.replay import files
from tests.xdf import xdf_file as made
from tests.xdf.own_streams import own_header

TEXTS = ["begin", "end"]


@pytest.fixture
def page(tmp_path: Path) -> Page:
    (tmp_path / "state").mkdir()
    return Page(tmp_path / "state", "")


def marked(number: int) -> bytes:
    return made.stream_header(number, "Marks", channels=1, rate=0, fmt="string") + made.samples(
        number, "string", [[each] for each in TEXTS], [files.BEGIN_S + 1.0, files.BEGIN_S + 2.0]
    )


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    folder = tmp_path / "study"
    folder.mkdir()
    return files.write(folder / "one.xdf", files.regular(1, "Wave", 50.0, 5.0), marked(2))


async def exported(page: Page, **content: Any) -> dict[str, Any]:
    code, view = await page.answer("POST", "recordings/export", json.dumps(content).encode())
    assert code == 200, view
    while view["is_running"]:
        await asyncio.sleep(0.01)
        _, view = await page.answer("GET", "recordings/export", b"")
    return view


def test_a_recording_is_judged_with_words_and_its_markers_have_times(
    page: Page, recording: Path
) -> None:
    code, judged = page.ask("POST", "recordings/check", {"path": str(recording)})
    assert code == 200
    # It was not closed, which whoever analyses it must know.
    assert judged["colour"] in {"amber", "red"}
    worst = judged["findings"][0]
    assert worst["level"] != "note"
    assert worst["means"] and worst["to_do"]
    assert [each["text"] for each in judged["markers"]] == TEXTS
    first, last = (each["time_s"] for each in judged["markers"])
    assert last - first == pytest.approx(1.0)
    assert first == pytest.approx(1.0, abs=0.05)
    assert judged["marker_count"] == 2


async def test_a_folder_is_exported_and_what_was_not_is_said(page: Page, recording: Path) -> None:
    shutil.copy(recording, recording.with_name("two.xdf"))
    recording.with_name("broken.xdf").write_bytes(b"no recording")
    view = await exported(page, path=str(recording.parent), formats=["csv", "kubios"])
    done = {each["recording"]: each for each in view["done"]}
    assert view["count"] == len(done) == 3
    assert (recording.parent / "one.csv").exists() or list(recording.parent.glob("one*csv*"))
    # None has a heart, and one is no recording: neither is silent, neither keeps the rest away.
    assert not any(each["is_certain"] for each in done.values())
    written = {name for name, each in done.items() if each["is_written"]}
    assert written == {"one.xdf", "two.xdf"}
    assert any("kubios" in said for said in done["one.xdf"]["said"])
    assert any("broken.xdf" in said for said in done["broken.xdf"]["said"])


async def test_an_export_that_fails_as_nobody_foresaw_does_not_look_whole(
    page: Page, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken() -> Any:
        raise RuntimeError("a defect")

    monkeypatch.setattr(page_files, "FORMATS", {"csv": broken})
    monkeypatch.setattr(job, "FORMATS", {"csv": broken})
    view = await exported(page, path=str(recording), formats=["csv"])
    assert not view["done"]
    assert "a defect" in view["problem"]
    # Another one can be begun.
    monkeypatch.undo()
    assert (await exported(page, path=str(recording), formats=["csv"]))["done"]


async def test_nothing_is_overwritten(page: Page, recording: Path) -> None:
    first = await exported(page, path=str(recording), formats=["csv"])
    before = {path: path.read_bytes() for path in recording.parent.rglob("*") if path.is_file()}
    again = await exported(page, path=str(recording), formats=["csv"])
    assert not again["done"][0]["is_certain"]
    assert (first["done"][0]["is_written"], again["done"][0]["is_written"]) == (True, False)
    assert first["done"][0]["said"] != again["done"][0]["said"]
    after = {path: path.read_bytes() for path in recording.parent.rglob("*") if path.is_file()}
    assert after == before


@pytest.mark.parametrize(
    "content",
    [
        {"formats": []},
        {"formats": ["word"]},
        {"formats": ["csv"], "path": "relative.xdf"},
        {"formats": ["csv"], "output": "/nowhere/at/all"},
    ],
)
def test_what_cannot_be_exported_is_refused(
    page: Page, recording: Path, content: dict[str, Any]
) -> None:
    code, answer = page.ask("POST", "recordings/export", {"path": str(recording), **content})
    assert code in {400, 404, 422}
    assert answer["problem"]


def test_a_cut_recording_is_salvaged_beside_itself(page: Page, recording: Path) -> None:
    whole = recording.read_bytes()
    recording.write_bytes(whole[:-20])
    code, salvaged = page.ask("POST", "recordings/salvage", {"path": str(recording)})
    assert code == 200, salvaged
    assert Path(salvaged["written"]).parent == recording.parent
    assert salvaged["said"]
    assert recording.read_bytes() == whole[:-20]


@pytest.mark.seam
@pytest.mark.skipif(sys.platform != "linux", reason="each system has its own file manager")
def test_the_folder_is_opened_and_nothing_else(
    page: Page, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, opened = tmp_path / "bin" / "xdg-open", tmp_path / "opened.txt"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nprintf %s "$1" > {opened}\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:/usr/bin:/bin")
    code, _ = page.ask("POST", "recordings/open-folder", {"path": str(recording)})
    assert (code, opened.read_text()) == (200, str(recording.parent))
    program.write_text("#!/bin/sh\nexit 3\n")
    code, answer = page.ask("POST", "recordings/open-folder", {"path": str(recording)})
    assert code == 404
    assert str(recording.parent) in answer["problem"]


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "recordings/check"),
        ("POST", "recordings/salvage"),
        ("POST", "recordings/open-folder"),
        ("POST", "recordings/export"),
        ("DELETE", "recordings/export"),
        ("GET", "recordings/export"),
        ("GET", "recordings"),
        ("GET", "capture"),
        ("GET", "capture/whole"),
        ("POST", "capture"),
        ("POST", "capture/save"),
        ("DELETE", "capture"),
    ],
)
async def test_who_only_looks_on_has_none_of_it(page: Page, method: str, path: str) -> None:
    view = view_of(page.session, Path(biosensor_gateway.page.__file__).parent / "static")
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": b"{}"}

    async def send(message: Any) -> None:
        sent.append(message)

    for asked, expected in ((path, 404), ("status", 200)):
        scope = {
            "type": "http",
            "method": method if expected == 404 else "GET",
            "path": f"/api/v1/{asked}",
            "query_string": b"",
            "headers": [(b"content-type", b"application/json")],
        }
        sent.clear()
        await view(scope, receive, send)
        assert sent[0]["status"] == expected


# Whoever clicks has no options, so nothing that the page says names one without its command.

OPTION = re.compile(r"(?<!\w)--[a-z]")


def _sentences(told: object) -> list[str]:
    return re.findall(r'"((?:[^"\\]|\\.)*)"', json.dumps(told, ensure_ascii=False))


def test_no_explanation_of_a_finding_names_an_option_alone() -> None:
    for code in EXPLANATIONS:
        (told,) = all_explained([Finding(Level.ERROR, code, "", "a sentence")])
        for text in (told.means, told.to_do):
            assert "xdf salvage" not in text, text
            assert not OPTION.search(text) or "the command `" in text, text


ABSENT = Presence((), (), ("P01-zephyr-A-ecg",))
SEEN = VisibleStream("eye", "eye-id", "lab-pc")


@pytest.mark.parametrize(
    ("presence", "wanted"),
    [
        (Presence((), (), ()), ()),
        (ABSENT, (SEEN,)),
        (Presence((SEEN,), (), (), away=("P01's strap is paused",)), (SEEN,)),
    ],
)
def test_why_no_recording_begins_names_what_can_be_clicked(
    presence: Presence, wanted: tuple[VisibleStream, ...]
) -> None:
    request = RecordingRequest(folder=Path("/data"), labels=BidsLabels("P01"))
    with pytest.raises(RecorderError) as caught:
        require_startable(presence, wanted, request)
    told = clicked(str(caught.value))
    assert not OPTION.search(told)
    assert "biosensor-gateway" not in told
    assert "*" in told or "tick" in told


@pytest.mark.parametrize("shape", odd_shapes.files())
async def test_nothing_that_is_said_of_a_file_names_an_option_alone(
    shape: str, page: Page, tmp_path: Path
) -> None:
    name, data = odd_shapes.files()[shape]
    path = tmp_path / "study" / f"P07_{name}"
    path.parent.mkdir()
    path.write_bytes(data)
    told: list[object] = []
    for what in ("check", "salvage", "salvage"):
        body = json.dumps({"path": str(path)}).encode()
        told.append((await page.answer("POST", f"recordings/{what}", body))[1])
    formats = ["csv", "edf", "kubios"]
    told += [await exported(page, path=str(path), formats=formats) for _ in range(2)]
    for text in _sentences(told):
        assert not OPTION.search(text) or "the command `" in text, text
        assert "biosensor-gateway xdf salvage" not in text, text
        assert "biosensor-gateway xdf check" not in text, text


async def test_the_right_participant_is_chosen_on_the_page(page: Page, tmp_path: Path) -> None:
    path = tmp_path / "sub-P08_task-rest_eeg.xdf"
    path.write_bytes(
        made.xdf(
            own_header(1, DeviceIdentity("polar_h10", "A", "P07"), "ecg"),
            made.samples(1, "float32", [[1.0]] * 3, [1.0, 2, 3]),
        )
    )
    undecided = await exported(page, path=str(path), formats=["csv"])
    (said,) = (each for each in undecided["done"][0]["said"] if "Participant" in each)
    assert "choose under *Participant* which is right" in said
    for whose in ("sensors", "name"):
        folder = tmp_path / whose
        folder.mkdir()
        view = await exported(
            page, path=str(path), formats=["csv"], output=str(folder), whose=whose
        )
        assert view["done"][0]["is_written"]
        assert not any("Participant" in each for each in view["done"][0]["said"])


async def test_headers_that_are_lost_are_taken_from_another_recording(
    page: Page, tmp_path: Path
) -> None:
    whole = files.write(tmp_path / "whole.xdf", files.regular(1, "Wave", 50.0, 5.0))
    content = whole.read_bytes()
    broken = tmp_path / "broken.xdf"
    at = content.index(b"<info>", content.index(b"<info>") + 1)
    broken.write_bytes(content[:at] + b"\0" * 40 + content[at + 40 :])
    body = {"path": str(broken), "header_from": str(whole)}
    code, told = await page.answer("POST", "recordings/salvage", json.dumps(body).encode())
    assert code == 200, told
    with open_contents(Path(told["written"])) as contents:
        (stream,) = contents.streams
        assert (stream.header.name, stream.sample_count) == ("Wave", 250)
