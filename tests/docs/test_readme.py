"""The tables of the README agree with the code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"
GENERATOR = Path(__file__).with_name("sensor_table.py")


def _generate(document: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(GENERATOR), str(document), *options]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_table_of_sensors_is_up_to_date() -> None:
    result = _generate(README, "--check")
    assert result.returncode == 0, result.stderr


def test_a_table_that_was_edited_is_found_and_mended(tmp_path: Path) -> None:
    copy = tmp_path / "README.md"
    right = README.read_text(encoding="utf-8")
    copy.write_text(right.replace("| `zephyr/hr` | UInt8", "| `zephyr/hr` | UInt16"), "utf-8")

    assert _generate(copy, "--check").returncode == 1
    assert _generate(copy).returncode == 0
    assert copy.read_text(encoding="utf-8") == right


def test_a_document_without_markers_is_refused(tmp_path: Path) -> None:
    empty = tmp_path / "README.md"
    empty.write_text("no markers\n", "utf-8")
    assert "must be there once each" in _generate(empty).stderr
    assert empty.read_text(encoding="utf-8") == "no markers\n"


def test_the_readme_names_every_parameter_with_its_default() -> None:
    parameters = pytest.importorskip("lsl_to_ros.parameters")
    text = README.read_text(encoding="utf-8")
    for name, value in parameters.DEFAULTS.items():
        assert f"| `{name}` | `{str(value).lower()}` |" in text
    assert f"1 to {parameters.LENGTH_RANGE[-1]}" in text
