"""Files that are replaced in one step, and what is said of folders that a cloud service copies."""

from __future__ import annotations

import json
import math
import os
import stat
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import ConfigError, ConfigReason, cannot_write
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import UNWRITTEN_REPORTS, StatusWriter, snapshot
from biosensor_gateway.agent.device_set import Device
from biosensor_gateway.agent.single_instance import single_instance
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.driver import Connected
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.settings.places import (
    cloud_of,
    recordings_folder,
    usual_recordings_folder,
    warnings_of,
)
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system import state_file
from biosensor_gateway.system.new_file import new_file, new_place
from tests.rigs.open_elsewhere import SENTENCE, hold_open

# A file is there whole or not at all, and never in the place of another.


@pytest.fixture
def like(tmp_path: Path) -> Path:
    path = tmp_path / "like"
    path.touch()
    return path


def names(folder: Path) -> set[str]:
    return {each.name for each in folder.iterdir()}


def test_it_has_its_name_when_it_is_whole(like: Path, tmp_path: Path) -> None:
    path = tmp_path / "new"
    with new_file(path, like) as file:
        file.write(b"first\n")
        file.flush()
        assert not path.exists()
    assert path.read_bytes() == b"first\n"
    assert names(tmp_path) == {"like", "new"}


@pytest.mark.parametrize("make", [new_file, new_place])
def test_a_name_that_windows_does_not_give_leaves_nothing(
    make: Callable[[Path, Path], Any], like: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write() -> None:
        with make(tmp_path / "new", like) as made:
            made.write_bytes(b"first") if isinstance(made, Path) else made.write(b"first")
            # A search for viruses looks at what was made.
            hold_open(monkeypatch, *tmp_path.glob("new.*.part"), *tmp_path.glob("new.*.part/new"))

    with pytest.raises(PermissionError) as caught:
        write()
    assert SENTENCE in cannot_write("new", caught.value)
    monkeypatch.undo()
    assert not (tmp_path / "new").exists()


def test_a_place_that_is_taken_is_refused_before_anything_is_made(
    like: Path, tmp_path: Path
) -> None:
    path = tmp_path / "taken"
    path.mkdir()
    with pytest.raises(FileExistsError), new_place(path, like):
        pytest.fail("something was made")
    assert names(tmp_path) == {"like", "taken"}


def test_after_an_error_nothing_is_left(like: Path, tmp_path: Path) -> None:
    def write() -> None:
        with new_file(tmp_path / "new", like) as file:
            file.write(b"first")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert names(tmp_path) == {"like"}


def test_what_somebody_has_put_there_meanwhile_stays(like: Path, tmp_path: Path) -> None:
    path = tmp_path / "new"

    def write() -> None:
        with new_file(path, like) as file:
            file.write(b"mine")
            path.write_bytes(b"somebody's")

    with pytest.raises(FileExistsError):
        write()
    assert path.read_bytes() == b"somebody's"
    assert names(tmp_path) == {"like", "new"}


def test_what_a_killed_process_of_this_number_left_is_no_hindrance(
    like: Path, tmp_path: Path
) -> None:
    path = tmp_path / "new"
    path.with_name(f"new.{os.getpid()}.part").write_bytes(b"long ago")
    with new_file(path, like) as file:
        file.write(b"now")
    assert path.read_bytes() == b"now"
    assert names(tmp_path) == {"like", "new"}


# Files of the state folder are replaced in one step, also while somebody reads them.
Refuse = Callable[[str, int], None]


@pytest.fixture
def refuse(monkeypatch: pytest.MonkeyPatch) -> Refuse:
    """Let so many calls fail as Windows lets them fail while another program has the file."""

    def apply(name: str, times: int) -> None:
        real, left = getattr(Path, name), [times]

        def call(path: Path, *args: object, **options: object) -> object:
            if left[0]:
                left[0] -= 1
                raise PermissionError(13, "in use", str(path))
            return real(path, *args, **options)

        monkeypatch.setattr(Path, name, call)

    return apply


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "not there yet" / "state.json"


def names_in(path: Path) -> list[str]:
    return [each.name for each in path.parent.iterdir()]


@pytest.mark.parametrize("durable", [True, False])
def test_a_file_is_made_and_replaced(path: Path, durable: bool) -> None:
    for text in ("first", "zweitens äöü"):
        state_file.replace(path, text, durable=durable)
        assert state_file.read(path) == text
        assert names_in(path) == [path.name]


@pytest.mark.nightly
def test_what_was_there_stays_if_it_cannot_be_replaced(path: Path, refuse: Refuse) -> None:
    state_file.replace(path, "old")
    refuse("replace", 1000)
    with pytest.raises(PermissionError, match=path.name):
        state_file.replace(path, "new")
    assert state_file.read(path) == "old"
    assert names_in(path) == [path.name]


@pytest.mark.nightly
def test_a_reader_at_that_moment_only_delays(path: Path, refuse: Refuse) -> None:
    state_file.replace(path, "old")
    refuse("replace", 2)
    state_file.replace(path, "new")
    refuse("read_text", 2)
    assert state_file.read(path) == "new"


@pytest.mark.nightly
def test_a_file_that_must_not_be_read_is_said(path: Path, refuse: Refuse) -> None:
    state_file.replace(path, "text")
    refuse("read_text", 1000)
    with pytest.raises(PermissionError):
        state_file.read(path)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no such modes")
def test_a_private_file_never_is_another_s(path: Path) -> None:
    path.parent.mkdir()
    left = path.with_name(f"{path.name}.{os.getpid()}")
    left.touch()
    left.chmod(0o666)
    state_file.replace(path, "secret", private=True)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert names_in(path) == [path.name]


@pytest.mark.skipif(sys.platform == "win32", reason="folders of a user are the user's there")
def test_nobody_else_looks_into_what_is_made(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    state_file.replace(tmp_path / "state" / "page" / "status.json", "{}")
    for made in (tmp_path / "state", tmp_path / "state" / "page"):
        assert stat.S_IMODE(made.stat().st_mode) == 0o700
    assert stat.S_IMODE(tmp_path.stat().st_mode) == 0o755


def test_a_file_in_the_place_of_a_folder_is_said(tmp_path: Path) -> None:
    (tmp_path / "state").touch()
    with pytest.raises(OSError, match="directory"):
        state_file.make_folder(tmp_path / "state")


# Folders that a program copies to a cloud service.
@pytest.mark.parametrize(
    ("folder", "cloud"),
    [
        ("/u/x/OneDrive/Documents/Biosensor recordings", "OneDrive"),
        ("/u/x/OneDrive - Some University/study", "OneDrive"),
        ("/u/x/onedrive", "OneDrive"),
        ("/u/x/Dropbox (Lab)/study", "Dropbox"),
        ("/u/x/Google Drive/study", "Google Drive"),
        ("/u/x/iCloudDrive", "iCloud"),
        ("/Users/x/Library/Mobile Documents/study", "iCloud"),
        ("/Users/x/Library/CloudStorage/Box-Box/study", "a cloud service"),
        ("/home/x/Nextcloud/study", "Nextcloud or ownCloud"),
        ("/u/x/Documents/Biosensor recordings", ""),
        ("/u/x/OneDriver/study", ""),
        ("/u/x/notes on Dropbox/study", ""),
    ],
)
def test_usual_names_are_known(folder: str, cloud: str) -> None:
    assert cloud_of(Path(folder), {}) == cloud


def test_onedrive_names_its_folder_itself() -> None:
    named = {"OneDriveCommercial": "/d/work"}
    assert cloud_of(Path("/d/work/study"), named) == "OneDrive"
    assert not cloud_of(Path("/d/workshop/study"), named)


def test_recordings_stay_here_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    home, name = Path("/u/x"), "Biosensor recordings"
    assert recordings_folder(home / "Documents", home, name) == home / "Documents" / name
    monkeypatch.setenv("OneDrive", "/u/x/OneDrive")
    assert recordings_folder(home / "OneDrive/Documents", home, name) == home / name


@pytest.mark.skipif(sys.platform == "win32", reason="documents stand in the registry there")
def test_the_usual_folder_is_in_the_documents_of_this_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    assert usual_recordings_folder() == tmp_path / "Documents" / "Biosensor recordings"


def test_one_sentence_says_what_to_do() -> None:
    assert warnings_of(Path("/u/x/Documents")) == ()
    (sentence,) = warnings_of(Path("/u/x/OneDrive/study"))
    assert "OneDrive" in sentence
    assert "Choose a folder that is not synchronised" in sentence


@pytest.mark.parametrize(
    ("earlier", "now"),
    [("P01", "p01"), ("P01", "PO1"), ("P01", "P1"), ("P1", "P001"), ("Ll5", "lI5"), ("07", "7")],
)
def test_a_name_like_that_of_an_earlier_recording_is_told(
    tmp_path: Path, earlier: str, now: str
) -> None:
    for name in (earlier, now, "P10"):
        (tmp_path / f"sub-{name}" / "ses-S001" / "beh").mkdir(parents=True)
    (sentence,) = warnings_of(tmp_path / f"sub-{now}" / "ses-S001" / "beh")
    assert sentence.startswith(f"{tmp_path} also has recordings of {earlier}, and this one is of")
    assert warnings_of(tmp_path / "sub-P10" / "ses-S001" / "beh") == ()


# The status file: written whole, read with doubt.
class NoDriver:
    silence_limit_s = math.inf

    async def connect(self) -> Connected:
        raise NotImplementedError

    async def stream(self) -> None:
        raise NotImplementedError

    async def close(self) -> None:
        raise NotImplementedError


def status(age_s: float = 0.0, **more: object) -> dict[str, object]:
    return {"written": time.time() - age_s, "process": 1, "devices": [], **more}


def refusal(folder: Path) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        status_file.read_status(folder)
    return caught.value


def test_what_was_written_is_read(tmp_path: Path) -> None:
    folder = tmp_path / "not" / "there" / "yet"
    written = status(devices=[{"sensor": "zephyr"}])
    status_file.write_status(folder, written)
    assert status_file.read_status(folder) == written
    assert [path.name for path in folder.iterdir()] == [status_file.STATUS_FILE]


@pytest.mark.parametrize("age_s", [None, 3600.0])
def test_an_agent_that_can_write_no_status_still_runs(tmp_path: Path, age_s: float | None) -> None:
    """Its disk is full: since its start, or since then."""
    if age_s is not None:
        status_file.write_status(tmp_path, status(age_s))
    with single_instance(tmp_path):
        error = refusal(tmp_path)
    assert error.reason is ConfigReason.UNREADABLE
    assert "an agent is running" in str(error)
    assert "disk" in str(error)
    assert refusal(tmp_path).reason is ConfigReason.NOT_FOUND


def test_no_file_means_no_agent(tmp_path: Path) -> None:
    error = refusal(tmp_path)
    assert error.reason is ConfigReason.NOT_FOUND
    assert "biosensor-gateway run" in str(error)


def test_an_old_file_means_no_agent(tmp_path: Path) -> None:
    status_file.write_status(tmp_path, status(age_s=60))
    error = refusal(tmp_path)
    assert error.reason is ConfigReason.NOT_FOUND
    assert "60 s ago" in str(error)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"written": "now"}', '{"written": null}', "\xff\xfe"]
)
def test_a_damaged_file_is_said_to_be_damaged(tmp_path: Path, text: str) -> None:
    (tmp_path / status_file.STATUS_FILE).write_text(text, encoding="latin-1")
    error = refusal(tmp_path)
    assert error.reason is ConfigReason.UNREADABLE
    assert str(tmp_path) in str(error)


@pytest.mark.parametrize(
    ("refusals", "said"),
    [(UNWRITTEN_REPORTS - 1, 0), (2 * UNWRITTEN_REPORTS, 1)],
)
def test_a_reader_in_the_way_is_no_trouble_until_it_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refusals: int, said: int
) -> None:
    """Windows refuses to replace a file that somebody reads."""
    writer, written = StatusWriter(tmp_path), status_file.write_status
    left = refusals

    def write(folder: Path, content: dict[str, Any]) -> None:
        nonlocal left
        left -= 1
        if left >= 0:
            raise PermissionError(13, "in use")
        written(folder, content)

    monkeypatch.setattr(status_file, "write_status", write)
    with capture_logs() as lines:
        for _ in range(2):
            for _ in range(refusals + 1):
                writer.write(status())
            left = refusals
    told = [each for each in lines if "cannot be written" in str(each["event"])]
    assert len(told) == said
    assert status_file.read_status(tmp_path)["devices"] == []


def test_removing_says_that_the_agent_has_ended(tmp_path: Path) -> None:
    status_file.write_status(tmp_path, status())
    status_file.remove_status(tmp_path)
    status_file.remove_status(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_removing_never_fails(tmp_path: Path) -> None:
    in_the_way = tmp_path / "state"
    in_the_way.touch()
    status_file.remove_status(in_the_way)
    with pytest.raises(OSError, match="state"):
        status_file.write_status(in_the_way, status())


def test_a_reader_never_sees_half_a_file(tmp_path: Path) -> None:
    status_file.write_status(tmp_path, status(devices=["x" * 500_000]))
    ended = threading.Event()

    def write() -> None:
        while not ended.is_set():
            status_file.write_status(tmp_path, status(devices=["x" * 500_000]))

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for _ in range(50):
            assert len(status_file.read_status(tmp_path)["devices"][0]) == 500_000
    finally:
        ended.set()
        writer.join()


def test_a_snapshot_holds_every_device_and_stream_and_is_json(unit: str) -> None:
    sink = DeviceSink(DeviceIdentity("gateway", unit, "p01", "left"), declaration("gateway"))
    supervisor = Supervisor(NoDriver, sink)
    before = snapshot([Device(supervisor, sink)]).model_dump()["devices"][0]
    assert (before["state"], before["connections"]) == ("discovering", 0)
    assert (before["clock"], before["streams"]) == (None, {})
    sink.open(DeviceInfo(), {})
    sink.observe(1.0, 2.0)
    sink.dropped_bytes = 9
    sink.lost("events", 4)
    taken = snapshot([Device(supervisor, sink)]).model_dump()
    (device,) = json.loads(json.dumps(taken, allow_nan=False))["devices"]
    assert {key: device[key] for key in ("sensor", "unit", "participant", "label")} == {
        "sensor": "gateway", "unit": unit, "participant": "p01", "label": "left"
    }  # fmt: skip
    assert device["dropped_bytes"] == 9
    assert device["clock"]["offset_s"] == 1.0
    lost = {name: counters["lost"] for name, counters in device["streams"].items()}
    names = {"counters": 0, "events": 4, "markers": 0}
    assert lost == {f"p01@gateway.left-{name}": count for name, count in names.items()}
    sink.close()
