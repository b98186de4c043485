"""The changelog's fragments and CITATION.cff are whole and agree with the project."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

# Each fragment of the changelog has a right name and text, and all are joined into one page.

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "changelog.d"
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONFIG = PROJECT["tool"]["towncrier"]
TYPES = [each["directory"] for each in CONFIG["type"]]
FRAGMENT = re.compile(rf"[a-z0-9]+(?:-[a-z0-9]+)*\.(?:{'|'.join(TYPES)})\.md")


def wrongly_named(folder: Path) -> list[str]:
    """Return the files that are neither fragments nor part of the house."""
    names = sorted(path.name for path in folder.iterdir())
    return [name for name in names if name not in CONFIG["ignore"] and not FRAGMENT.fullmatch(name)]


def test_fragments_have_right_names() -> None:
    assert wrongly_named(FOLDER) == []


def test_fragments_are_a_few_sentences_and_no_list() -> None:
    texts = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.*.md")}
    whole = re.compile(r"[^-*#\n][^\n]*(?:\n[^\n]+)*[.:]\n")
    assert [name for name, text in texts.items() if not whole.fullmatch(text)] == []


def test_the_changelog_has_a_place_for_versions() -> None:
    assert (ROOT / CONFIG["filename"]).read_text(encoding="utf-8").count(
        CONFIG["start_string"]
    ) == 1


def test_fragments_are_joined_by_type(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fragments = tmp_path / CONFIG["directory"]
    fragments.mkdir()
    (fragments / "one.fixed.md").write_text("One is fixed,\nreally.\n")
    (fragments / "two.added.md").write_text("Two is added.\n")
    template = Path(CONFIG["template"])
    (tmp_path / template).write_bytes((ROOT / template).read_bytes())
    (tmp_path / "pyproject.toml").write_bytes((ROOT / "pyproject.toml").read_bytes())
    monkeypatch.chdir(tmp_path)
    (script,) = entry_points(group="console_scripts", name="towncrier")
    arguments = ["build", "--draft", "--version", "1.2.3", "--date", "2026-01-31"]
    drawn = CliRunner().invoke(script.load(), arguments, catch_exceptions=False)
    assert drawn.output.partition("would be written.\n")[2].strip() == (
        "## 1.2.3 - 2026-01-31\n\n### Added\n\n- Two is added.\n\n"
        "### Fixed\n\n- One is fixed,\n  really."
    ), drawn.output


# CITATION.cff says what the project's other files say.
CITATION: dict[str, Any] = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))


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
    assert str(CITATION["version"]) == PROJECT["project"]["version"]
    assert CITATION["license"] == PROJECT["project"]["license"]
    assert CITATION["keywords"] == PROJECT["project"]["keywords"]


def test_a_date_of_release_is_that_of_the_changelog() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    version = re.escape(PROJECT["project"]["version"])
    dated = re.search(rf"^## \[?{version}\]? - (\d{{4}}-\d\d-\d\d)$", changelog, re.MULTILINE)
    released = CITATION.get("date-released")
    # A version that is not released yet has none.
    assert (str(released) if released else None) == (dated[1] if dated else None)
