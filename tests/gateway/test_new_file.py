"""A file is there whole or not at all, and never in the place of another."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from biosensor_gateway.system.new_file import new_file


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
