"""Each inlet of the product is made in one place and opened with a limit."""

from __future__ import annotations

import ast
import ctypes
import os
import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PRODUCT = ("common", "gateway_win", "ros_side")
MAKER = "common/biosensor_common/lsl/inlet.py"
# Each of them waits without a limit by default.
WAITING = {"open_stream", "info", "time_correction"}
PULLING = {"pull_chunk", "pull_sample"}


def _calls(module: ast.Module) -> Iterator[tuple[str, ast.Call]]:
    for node in ast.walk(module):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            yield name, node


def _modules() -> dict[str, list[tuple[str, ast.Call]]]:
    return {
        str(path.relative_to(ROOT)): list(_calls(ast.parse(text)))
        for folder in PRODUCT
        for path in (ROOT / folder).rglob("*.py")
        if "build" not in path.parts and "nlet" in (text := path.read_text("utf-8"))
    }


def test_inlets_are_made_in_one_place_and_never_recover() -> None:
    makers = [path for path, calls in _modules().items() if "StreamInlet" in dict(calls)]
    assert [path for path in makers if path != MAKER] == []
    (made,) = (call for name, call in _modules()[MAKER] if name == "StreamInlet")
    assert {each.arg: ast.unparse(each.value) for each in made.keywords}["recover"] == "False"


def test_nothing_is_asked_of_an_inlet_without_a_limit() -> None:
    unlimited = [
        f"{path}:{call.lineno}"
        for path, calls in _modules().items()
        for name, call in calls
        if name in WAITING and not call.args and not call.keywords
    ]
    assert unlimited == []


def test_descriptions_are_read_in_one_place_which_looks_whose_they_are() -> None:
    readers = [
        path
        for path, calls in _modules().items()
        for name, call in calls
        if name == "info"
        and ast.unparse(call.args[0] if call.args else call).endswith(("_S", "limit_s"))
    ]
    assert readers == [MAKER]


def test_who_makes_an_inlet_unopened_opens_it_before_a_pull() -> None:
    unopened = {
        path
        for path, calls in _modules().items()
        if "unopened_inlet" in (names := {name for name, _ in calls})
        and names & PULLING
        and "open_stream" not in names
        # It makes one for the clock, and the one that it pulls from open.
        and "open_inlet" not in {each.id for each in _names(path)}
    }
    assert unopened == set()


def _names(path: str) -> Iterator[ast.Name]:
    module = ast.parse((ROOT / path).read_text("utf-8"))
    return (node for node in ast.walk(module) if isinstance(node, ast.Name))


def test_liblsl_is_called_in_a_way_that_windows_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    def as_on_windows(kind: type[ctypes.CDLL]) -> type[ctypes.CDLL]:
        class Named(kind):
            def __init__(self, name: str, *, handle: int | None = None) -> None:
                # There it looks for a folder in the name, also if there is a handle.
                super().__init__(os.fspath(name), handle=handle)

        return Named

    for kind in (ctypes.CDLL, ctypes.PyDLL):
        monkeypatch.setattr(ctypes, kind.__name__, as_on_windows(kind))
    assert callable(runpy.run_path(str(ROOT / MAKER))["Block"])
