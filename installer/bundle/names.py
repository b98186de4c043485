"""Compares names of packages and files."""

from __future__ import annotations

import fnmatch
import re


def normalised(name: str) -> str:
    """Return a package's name as PyPI compares it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def base_name(path: str) -> str:
    """Return the last part of a path of either system."""
    return re.split(r"[/\\]", path)[-1]


def matches(path: str, patterns: tuple[str, ...]) -> bool:
    """Tell whether the last part of a path is like a pattern, whatever the case, as on Windows."""
    name = base_name(path).lower()
    return any(fnmatch.fnmatchcase(name, pattern.lower()) for pattern in patterns)
