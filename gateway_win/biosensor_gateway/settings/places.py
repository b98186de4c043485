"""The paths of the settings file and of the state folder, and the folder of a user's recordings."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import platformdirs

from biosensor_common.lsl.api_file import home_folder

APP_NAME = "biosensor-gateway"
SETTINGS_VARIABLE = "BIOSENSOR_GATEWAY_SETTINGS"
STATE_VARIABLE = "BIOSENSOR_GATEWAY_STATE"


def settings_path() -> Path:
    """Return ``BIOSENSOR_GATEWAY_SETTINGS``, or the settings file in the user's config folder.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if the user has no home folder.
    """
    chosen = os.environ.get(SETTINGS_VARIABLE)
    if chosen:
        return Path(chosen).expanduser()
    home_folder()
    return platformdirs.user_config_path(APP_NAME, appauthor=False) / "settings.toml"


def state_folder() -> Path:
    """Return ``BIOSENSOR_GATEWAY_STATE``, or the user's state folder, for status and logs.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if the user has no home folder.
    """
    chosen = os.environ.get(STATE_VARIABLE)
    if chosen:
        return Path(chosen).expanduser()
    home_folder()
    return platformdirs.user_state_path(APP_NAME, appauthor=False)


_ONEDRIVE = ("OneDrive", "OneDriveConsumer", "OneDriveCommercial")
"""Environment variables with OneDrive's folders, which can have any name."""
_FOLDERS = (
    (re.compile(r"OneDrive( - .+)?", re.IGNORECASE), "OneDrive"),
    (re.compile(r"Dropbox( \(.+\))?", re.IGNORECASE), "Dropbox"),
    (re.compile(r"Google ?Drive|My Drive|DriveFS", re.IGNORECASE), "Google Drive"),
    (re.compile(r"iCloud ?Drive|Mobile Documents", re.IGNORECASE), "iCloud"),
    (re.compile(r"Nextcloud|ownCloud", re.IGNORECASE), "Nextcloud or ownCloud"),
    (re.compile(r"CloudStorage"), "a cloud service"),
)
"""Default names of such folders; on macOS they are all in CloudStorage."""
_SUBJECT = "sub-"
_LEADING_ZEROS = re.compile(r"(?<!\d)0+(?=\d)")
_RECORDINGS = "Biosensor recordings"
_FETCHED_WHEN_OPENED = 0x00040000 | 0x00400000
"""FILE_ATTRIBUTE_RECALL_ON_OPEN and FILE_ATTRIBUTE_RECALL_ON_DATA_ACCESS of Windows."""


def cloud_of(folder: Path, variables: Mapping[str, str] = os.environ) -> str:
    """Return the name of the service that synchronizes a folder; empty if none is known."""
    for name in _ONEDRIVE:
        of_onedrive = variables.get(name)
        if of_onedrive and folder.is_relative_to(of_onedrive):
            return "OneDrive"
    for part in reversed(folder.parts):
        for pattern, title in _FOLDERS:
            if pattern.fullmatch(part):
                return title
    return "a cloud service" if _is_fetched_when_opened(folder) else ""


def warnings_of(folder: Path) -> tuple[str, ...]:
    """Return the warnings about a folder of recordings."""
    cloud = cloud_of(folder)
    sentence = (
        f"{cloud} copies {folder} to other computers: people's recordings leave this computer, "
        "and the file may be locked while it grows. Choose a folder that is not synchronised"
    )
    return (*([sentence] if cloud else ()), *_of_mistyped(folder))


def _of_mistyped(folder: Path) -> Iterator[str]:
    """Report other participants' folders whose names resemble that of this recording."""
    own = next((each for each in (folder, *folder.parents) if each.name.startswith(_SUBJECT)), None)
    if own is None:
        return
    try:
        beside = sorted(
            each.name for each in own.parent.iterdir() if each.name.startswith(_SUBJECT)
        )
    except OSError:
        beside = []
    alike = [each for each in beside if each != own.name and _looks(each) == _looks(own.name)]
    if alike:
        names = ", ".join(each.removeprefix(_SUBJECT) for each in alike)
        yield (
            f"{own.parent} also has recordings of {names}, and this one is of "
            f"{own.name.removeprefix(_SUBJECT)}: if that is the same person, stop, correct the "
            "name and record again"
        )


def _looks(name: str) -> str:
    """Return a name with easily confused letters made equal: case, O/0, I/l/1, leading zeros."""
    return _LEADING_ZEROS.sub("", name.casefold().translate(str.maketrans("oil", "011")))


def usual_recordings_folder() -> Path:
    """Return the default folder of this user's recordings."""
    return recordings_folder(platformdirs.user_documents_path(), home_folder(), _RECORDINGS)


def recordings_folder(documents: Path, home: Path, name: str) -> Path:
    """Return a folder in the documents, or in the home folder if the documents are synchronized."""
    return (home if cloud_of(documents) else documents) / name


def _is_fetched_when_opened(folder: Path) -> bool:
    if sys.platform != "win32":
        return False
    try:
        return bool(folder.stat().st_file_attributes & _FETCHED_WHEN_OPENED)
    except OSError:
        # The folder does not exist until something is recorded.
        return False
