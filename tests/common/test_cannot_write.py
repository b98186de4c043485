"""A file that cannot be written: what, where, and what to do."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from biosensor_common.errors import cannot_write


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.EACCES, "choose another place"),
        (errno.EROFS, "another disk"),
        (errno.ENOSPC, "make room"),
        (errno.ENAMETOOLONG, "a shorter name"),
        (errno.ENOENT, "make its folder first"),
    ],
)
def test_it_says_what_where_and_what_to_do(number: int, advice: str) -> None:
    path = Path("study") / "P01.csv"
    what, _, todo = cannot_write(path, OSError(number, os.strerror(number))).partition("; ")
    assert what == f"cannot write {path}: {os.strerror(number)}"
    assert advice in todo


def test_a_file_that_windows_has_open_elsewhere_is_to_be_closed() -> None:
    error = PermissionError(errno.EACCES, "The process cannot access the file")
    error.winerror = 32  # pyright: ignore[reportAttributeAccessIssue] - only Windows declares it
    assert cannot_write("table.csv", error).endswith("close the program that has it open")


def test_without_a_known_remedy_it_says_what_the_system_says() -> None:
    assert cannot_write("x.csv", OSError("no luck")) == "cannot write x.csv: no luck"


def test_a_real_folder_that_is_missing() -> None:
    missing = Path("no such folder") / "x.csv"
    with pytest.raises(OSError, match="No such file") as caught:
        missing.write_text("")
    assert "make its folder first" in cannot_write(missing, caught.value)
