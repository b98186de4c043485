"""Each module says first what it does or holds, in words that a stranger can look for."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PRODUCT = ("common", "gateway_win", "ros_side", "installer")
# "What a strap sends" makes a reader look on for whether it is sent, read or described here.
QUESTIONS = {"how", "what", "when", "where", "whether", "which", "who", "why"}


def _modules(folder: str) -> list[Path]:
    modules = [path for path in (ROOT / folder).rglob("*.py") if "build" not in path.parts]
    assert modules
    return modules


@pytest.mark.parametrize("folder", PRODUCT)
def test_a_module_begins_with_no_question(folder: str) -> None:
    said = {
        path: ast.get_docstring(ast.parse(path.read_text("utf-8"))) for path in _modules(folder)
    }
    questions = [
        f"{path.relative_to(ROOT)}: {text.splitlines()[0]}"
        for path, text in said.items()
        if text and text.split()[0].strip(",:").lower() in QUESTIONS
    ]
    assert questions == []
