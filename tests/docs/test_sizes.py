"""Files and functions of the product stay small enough to be read at once."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PRODUCT = ("common", "gateway_win", "ros_side", "installer")
LONGEST_FILE, LONGEST_FUNCTION = 300, 45
"""Lines; of a function those below its parameters and its docstring."""


def _modules(folder: str) -> Iterator[Path]:
    return (path for path in (ROOT / folder).rglob("*.py") if "build" not in path.parts)


def _functions(module: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    return (
        node
        for node in ast.walk(module)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    )


def _length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    body = function.body[1:] if ast.get_docstring(function) else function.body
    last = function.end_lineno or 0
    return last - body[0].lineno + 1 if body else 0


@pytest.mark.parametrize("folder", PRODUCT)
def test_files_are_short(folder: str) -> None:
    lengths = {path: len(path.read_text("utf-8").splitlines()) for path in _modules(folder)}
    assert lengths
    long = {str(path): lines for path, lines in lengths.items() if lines > LONGEST_FILE}
    assert long == {}


@pytest.mark.parametrize("folder", PRODUCT)
def test_functions_are_short(folder: str) -> None:
    long = {
        f"{path}, {function.name}": _length(function)
        for path in _modules(folder)
        for function in _functions(ast.parse(path.read_text("utf-8")))
        if _length(function) > LONGEST_FUNCTION
    }
    assert long == {}
