"""What the documents show of the code is what the code says."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.docs.generate import PARTS, ROOT, Part, main, updated

README = ROOT / "README.md"
REFERENCE = ROOT / "docs" / "ros-reference.md"
MAX_README_LINES = 150


def test_everything_that_is_generated_is_up_to_date() -> None:
    stale = [
        part.document
        for part in PARTS
        if updated(text := (ROOT / part.document).read_text(encoding="utf-8"), part) != text
    ]
    assert not stale, f"run: make docs ({stale})"


def test_a_table_that_was_edited_is_found_and_fixed(tmp_path: Path) -> None:
    for part in PARTS:
        (tmp_path / part.document).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / part.document, tmp_path / part.document)
    edited = tmp_path / "docs" / "topics.md"
    right = edited.read_text(encoding="utf-8")
    edited.write_text(right.replace("| `zephyr/hr` | UInt8", "| `zephyr/hr` | UInt16"), "utf-8")

    with pytest.raises(SystemExit, match=r"out of date: docs/topics.md; run: make docs"):
        main(["--check", "--root", str(tmp_path)])
    main(["--root", str(tmp_path)])
    assert edited.read_text(encoding="utf-8") == right


@pytest.mark.parametrize("part", [part for part in PARTS if part.name], ids=lambda part: part.name)
def test_a_document_without_markers_is_refused(part: Part) -> None:
    with pytest.raises(ValueError, match="must be there once each"):
        updated("no markers\n", part)


def test_the_readme_is_a_page() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= MAX_README_LINES


def test_the_reference_names_every_parameter_with_its_default() -> None:
    parameters = pytest.importorskip("lsl_to_ros.parameters.streams")
    text = REFERENCE.read_text(encoding="utf-8")
    for name, value in parameters.DEFAULTS.items():
        assert f"| `{name}` | `{str(value).lower()}` |" in text
    assert f"1 to {parameters.LENGTH_RANGE[-1]}" in text
