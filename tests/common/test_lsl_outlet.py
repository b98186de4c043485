"""Outlets end when what was pushed last is on its way, and all of ours are such outlets."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pylsl
import pytest
from pylsl.lib import lib

from biosensor_common.lsl.outlet import REST_S, LslOutlet

ROOT = Path(__file__).parents[2]
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
    assert others == ["survey.py"]
