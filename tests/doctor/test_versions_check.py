"""Versions and places, and libraries that are missing."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pylsl
import pytest
from pylsl.lib import lib

from biosensor_common.doctor.check import Level
from biosensor_gateway.doctor.context import Context
from tests.doctor.conftest import above_ok, only

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

pytestmark = pytest.mark.nightly


def test_what_runs_here(examine: Examine, context: Context) -> None:
    found = examine(context, "versions")
    assert not above_ok(found)
    assert only(found, f"Python {sys.version.split()[0]}, {sys.executable}")
    liblsl = only(found, f"), {lib._name}").what
    for detail in pylsl.library_info().split("/build:")[0].split("/branch:"):
        assert detail in liblsl
    # Else a terminal breaks a word; a path stays whole, so that it can be copied.
    words = [word for each in found for word in each.what.split() if "site-packages" not in word]
    assert max(map(len, words)) <= 68, words
    for name in ("biosensor-gateway ", "pylsl ", "bleak ", "numpy "):
        assert [each for each in found if each.what.startswith(name)]


def test_a_computer_without_liblsl(
    examine: Examine, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)
    found = only(examine(context, "versions"), "pylsl cannot be used")
    assert found.level is Level.ERROR
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    arm = only(examine(context, "versions"), "pylsl cannot be used")
    assert "https://github.com/sccn/liblsl/releases" in arm.fix


def test_an_old_liblsl(examine: Examine, context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pylsl, "library_version", lambda: 116)
    found = only(examine(context, "versions"), "is too old")
    assert found.level is Level.ERROR


def test_a_library_that_is_missing(
    examine: Examine, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "bleak", None)
    found = only(examine(context, "versions"), "bleak cannot be used")
    assert (found.level, found.fix.endswith(" bleak")) == (Level.ERROR, True)
