"""Files that another program has open, as on Windows, where nothing takes their place then."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

SHARING_VIOLATION = 32
SENTENCE = "close the program that has it open"


def hold_open(monkeypatch: pytest.MonkeyPatch, *files: Path) -> None:
    """Have the system refuse for files, and folders that they are in, what Windows refuses."""

    def refusing(real: Callable[..., Any]) -> Callable[..., Any]:
        def refuse(path: Path, *target: Path, **options: Any) -> Any:
            held = {each for file in files for each in (file, *file.parents)}
            if held & {Path(each) for each in (path, *target)}:
                text = "The process cannot access the file because another process uses it"
                error = PermissionError(errno.EACCES, text)
                error.winerror = SHARING_VIOLATION  # pyright: ignore[reportAttributeAccessIssue] - as there
                error.filename, *more = map(str, (path, *target))
                error.filename2 = more[0] if more else None
                raise error
            return real(path, *target, **options)

        return refuse

    for name in ("replace", "rename", "unlink"):
        monkeypatch.setattr(os, name, refusing(getattr(os, name)))
