"""Inlets are made in one place and opened with a limit; outlets end when all is on its way."""

from __future__ import annotations

import ast
import ctypes
import os
import re
import runpy
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pylsl
import pytest
from pylsl.lib import lib

from biosensor_common.lsl.outlet import REST_S, LslOutlet

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


PUSHES: dict[str, Callable[[LslOutlet], None]] = {
    "sample": lambda outlet: outlet.push_sample([1.0]),
    "chunk": lambda outlet: outlet.push_chunk(np.ones((3, 1), np.float32)),
    "by other means": lambda outlet: outlet.note_push(),
}


@pytest.fixture
def ended_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """When liblsl was told to destroy an outlet."""
    ends: list[float] = []
    destroy: Any = lib.lsl_destroy_outlet

    def noted(handle: Any) -> None:
        ends.append(time.monotonic())
        destroy(handle)

    monkeypatch.setattr(lib, "lsl_destroy_outlet", noted)
    return ends


def _outlet() -> LslOutlet:
    return LslOutlet(pylsl.StreamInfo("ends", "Test", 1, 100.0, "float32", "ends"))


@pytest.mark.seam
@pytest.mark.parametrize("push", PUSHES.values(), ids=PUSHES)
def test_it_ends_some_time_after_the_last_push(
    push: Callable[[LslOutlet], None], ended_s: list[float]
) -> None:
    outlet = _outlet()
    push(outlet)
    pushed_s = time.monotonic()
    del outlet
    assert len(ended_s) == 1
    # The clock was read a moment before here.
    assert ended_s[0] >= pushed_s + 0.9 * REST_S


@pytest.mark.nightly
def test_one_that_pushed_nothing_lately_does_not_wait(
    ended_s: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    outlet, idle = _outlet(), _outlet()
    outlet.push_sample([1.0])
    time.sleep(REST_S)
    monkeypatch.setattr(time, "sleep", slept.append)
    del outlet, idle
    assert slept == [0.0, 0.0]
    assert len(ended_s) == 2


def test_no_program_of_ours_has_another_outlet() -> None:
    modules = [
        path
        for folder in ("common", "gateway_win", "ros_side")
        for path in (ROOT / folder).rglob("*.py")
        if not {"build", "test"} & set(path.parts)
    ]
    others = [each.name for each in modules if re.search(r"\bStreamOutlet\(", each.read_text())]
    # The doctor's is ended with its process.
    assert others == ["lsl_process.py"]
