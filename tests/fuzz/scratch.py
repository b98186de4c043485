"""A file for readers that want a path."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path


@cache
def folder() -> Path:
    """Return a folder of this process, removed at its end."""
    made = Path(tempfile.mkdtemp(prefix="biosensor-gateway-fuzz-"))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def written(name: str, data: bytes) -> Path:
    """Write the file again, and return where it is."""
    path = folder() / name
    path.write_bytes(data)
    return path
