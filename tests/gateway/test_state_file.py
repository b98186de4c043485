"""Files of the state folder are replaced in one step, also while somebody reads them."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from biosensor_gateway.system import state_file

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


def names(path: Path) -> list[str]:
    return [each.name for each in path.parent.iterdir()]


@pytest.mark.parametrize("durable", [True, False])
def test_a_file_is_made_and_replaced(path: Path, durable: bool) -> None:
    for text in ("first", "zweitens äöü"):
        state_file.replace(path, text, durable=durable)
        assert state_file.read(path) == text
        assert names(path) == [path.name]


@pytest.mark.nightly
def test_what_was_there_stays_if_it_cannot_be_replaced(path: Path, refuse: Refuse) -> None:
    state_file.replace(path, "old")
    refuse("replace", 1000)
    with pytest.raises(PermissionError, match=path.name):
        state_file.replace(path, "new")
    assert state_file.read(path) == "old"
    assert names(path) == [path.name]


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
    assert names(path) == [path.name]


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
