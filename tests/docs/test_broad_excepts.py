"""Whoever catches everything says in the same line why; CONTRIBUTING.md says where that may be."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("common", "gateway_win", "ros_side")
BROAD = {"Exception", "BaseException"}
# The part behind the rule that ruff is told to leave out, of so many words at least.
REASON = re.compile(r"#(?: noqa: BLE001 -)?(?! noqa)(?: \S+){4,}$")


def _is_broad(caught: ast.expr | None) -> bool:
    if isinstance(caught, ast.Tuple):
        return any(map(_is_broad, caught.elts))
    return caught is None or (isinstance(caught, ast.Name) and caught.id in BROAD)


def _broad_lines(source: str) -> Iterator[str]:
    """Give the lines that catch or suppress everything."""
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.ExceptHandler(type=caught):
                is_broad = _is_broad(caught)
            case ast.Call(
                func=ast.Name(id="suppress") | ast.Attribute(attr="suppress"), args=suppressed
            ):
                is_broad = any(map(_is_broad, suppressed))
            case _:
                continue
        if is_broad:
            yield lines[node.lineno - 1]


def _without_reason(source: str) -> list[str]:
    return [line.strip() for line in _broad_lines(source) if not REASON.search(line)]


@pytest.mark.parametrize("package", PACKAGES)
def test_each_broad_except_has_its_reason_in_its_line(package: str) -> None:
    modules = [path for path in (ROOT / package).rglob("*.py") if "build" not in path.parts]
    assert modules
    bare = {
        str(path.relative_to(ROOT)): found
        for path in modules
        if (found := _without_reason(path.read_text("utf-8")))
    }
    assert bare == {}


@pytest.mark.parametrize(
    "caught",
    [
        "except:",
        "except Exception:",
        "except Exception:  # noqa: BLE001",
        "except Exception:  # noqa: BLE001 - it fails",
        "except BaseException as error:  # whatever",
        "except (ValueError, Exception) as error:",
    ],
)
def test_one_without_a_reason_is_found(caught: str) -> None:
    assert _without_reason(f"try:\n    pass\n{caught}\n    pass\n") == [caught]


@pytest.mark.parametrize("call", ["suppress(Exception)", "contextlib.suppress(OSError, Exception)"])
def test_suppressing_everything_is_found(call: str) -> None:
    assert _without_reason(f"with {call}:\n    pass\n") == [f"with {call}:"]


@pytest.mark.parametrize(
    "caught",
    [
        "except ValueError:",
        "except Exception:  # noqa: BLE001 - a driver must not end the others",
        "except Exception as error:  # backends raise what their system does",
    ],
)
def test_a_class_or_a_reason_is_enough(caught: str) -> None:
    assert _without_reason(f"try:\n    pass\n{caught}\n    pass\n") == []
