"""Programs of the system are started from the system's folders, never from the current one."""

from __future__ import annotations

import ast
import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from biosensor_common.child import full_path, output_of

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = ("common", "gateway_win", "ros_side/lsl_to_ros/lsl_to_ros")
CURRENT = ["", ".", "bin", "../here"]


def plant(folder: Path, name: str, word: str) -> Path:
    program = folder / name
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text(f"#!/bin/sh\necho {word}\n")
    program.chmod(0o755)
    return program


@pytest.mark.nightly
@pytest.mark.parametrize("entry", CURRENT)
def test_what_lies_in_the_current_folder_is_not_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: str
) -> None:
    here = tmp_path / "here"
    plant(here / entry, "timedatectl", "planted")
    right = plant(tmp_path / "system", "timedatectl", "right")
    monkeypatch.chdir(here)
    monkeypatch.setenv("PATH", entry)
    assert full_path("timedatectl") is None
    assert output_of("timedatectl") is None
    monkeypatch.setenv("PATH", os.pathsep.join([entry, str(right.parent)]))
    assert full_path("timedatectl") == str(right)
    assert output_of("timedatectl") == "right\n"


def test_what_is_no_program_is_not_taken_for_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "first" / "folder").mkdir(parents=True)
    (tmp_path / "first" / "text").write_text("")
    for name in ("folder", "text"):
        plant(tmp_path / "second", name, "right")
    places = [str(tmp_path / each) for each in ("none", "first", "second")]
    monkeypatch.setenv("PATH", os.pathsep.join(places))
    assert full_path("folder") == str(tmp_path / "second" / "folder")
    assert full_path("text") == str(tmp_path / "second" / "text")


def test_a_folder_that_the_user_may_not_look_into_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(tmp_path / "forbidden", "cat", "planted")
    right = plant(tmp_path / "second", "cat", "right")
    monkeypatch.setenv("PATH", os.pathsep.join(map(str, (tmp_path / "forbidden", right.parent))))
    stat = os.stat

    def refused(path: str | Path, **options: Any) -> os.stat_result:
        if "forbidden" in str(path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return stat(path, **options)

    # Root may look into every folder.
    monkeypatch.setattr(os, "stat", refused)
    assert full_path("cat") == str(right)


def sources() -> Iterator[tuple[Path, ast.AST]]:
    for folder in PRODUCT:
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                yield path.relative_to(ROOT), node


def by_name(call: ast.Call) -> bool:
    """Whether a program is looked for, or started, by its name alone."""
    name = ast.unparse(call.func)
    if name in {"shutil.which", "which", "os.system", "os.popen"}:
        return True
    command = call.args[0] if name.startswith("subprocess.") and call.args else None
    return isinstance(command, ast.List) and isinstance(command.elts[0], ast.Constant)


def in_current_folder(command: ast.List | ast.Tuple) -> bool:
    """Whether Python is started by ``-m`` alone, which imports a ``json.py`` of that folder."""
    words = [ast.unparse(each) for each in command.elts]
    return "'-m'" in words and "'-P'" not in words


def test_nothing_of_the_product_is_started_by_its_name_or_from_the_current_folder() -> None:
    found: list[str] = []
    for path, node in sources():
        if isinstance(node, ast.Call) and by_name(node):
            found.append(f"{path}:{node.lineno}: ask biosensor_common.child")
        if isinstance(node, ast.List | ast.Tuple) and in_current_folder(node):
            found.append(f"{path}:{node.lineno}: start Python with -P -m")
    assert not found
