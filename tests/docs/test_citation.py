"""CITATION.cff says what the project's other files say."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
CITATION: dict[str, Any] = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]


def test_it_has_what_the_format_demands() -> None:
    assert CITATION["cff-version"] == "1.2.0"
    assert CITATION["message"]
    assert CITATION["title"]
    assert CITATION["type"] == "software"
    assert CITATION["authors"]
    assert all(author["name"] for author in CITATION["authors"])
    known = {
        "abstract", "authors", "cff-version", "date-released", "doi", "identifiers", "keywords",
        "license", "message", "repository-code", "title", "type", "url", "version",
    }  # fmt: skip
    assert set(CITATION) <= known


def test_it_agrees_with_the_package() -> None:
    assert str(CITATION["version"]) == PROJECT["version"]
    assert CITATION["license"] == PROJECT["license"]
    assert CITATION["keywords"] == PROJECT["keywords"]


def test_a_date_of_release_is_that_of_the_changelog() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    version = re.escape(PROJECT["version"])
    dated = re.search(rf"^## \[?{version}\]? - (\d{{4}}-\d\d-\d\d)$", changelog, re.MULTILINE)
    released = CITATION.get("date-released")
    # A version that is not released yet has none.
    assert (str(released) if released else None) == (dated[1] if dated else None)
