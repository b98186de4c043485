"""Folders that a program copies to a cloud service."""

from __future__ import annotations

from pathlib import Path

import pytest

from biosensor_gateway.system.cloud_folders import cloud_of, recordings_folder, warnings_of


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


def test_one_sentence_says_what_to_do() -> None:
    assert warnings_of(Path("/u/x/Documents")) == ()
    (sentence,) = warnings_of(Path("/u/x/OneDrive/study"))
    assert "OneDrive" in sentence
    assert "Choose a folder that stays here" in sentence
