"""The wheel on 64-bit ARM, emulated: installed, tried, recorded and exported."""

from __future__ import annotations

import json
import re
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.wheel.arm64 import LIMIT_S, Arm64, installed, needs
from tests.wheel.conftest import Installed

MISSING = needs()
FORMATS = ("bids", "csv", "edf", "mcap")
# Errors of a recording that no slow computer makes.
BY_PROCESSOR = {
    *("damaged", "no-header", "footer-count", "duplicate-source-id", "counters", "too-many"),
    *("wrong-clock", "bad-stamps", "stray-stamps", "backwards"),
}

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.system,
    pytest.mark.timeout(3900),
    pytest.mark.skipif(bool(MISSING), reason=f"NOT RUN: {MISSING}"),
]


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Generator[Arm64]:
    with installed(tmp_path_factory.mktemp("arm64")) as debian:
        yield debian


def test_it_shows_itself_in_one_command(arm: Arm64, wheel: Path, tmp_path: Path) -> None:
    assert "aarch64" in arm.run("doctor", codes=(0, 1))
    # How much of it is held, and so the colour, says how fast the emulation was; but red is red.
    said = arm.run("try", "--no-open", "--seconds", "20", codes=(0, 1))
    assert "3 sensors stream." in said
    assert re.search(r"^(green|amber|red): ", said, re.MULTILINE), said
    for stream in ("polar_h10-virtual-ecg", "shimmer3_gsr-virtual-gsr"):
        found = re.search(rf"^ *{stream} +(\d+) ", said, re.MULTILINE)
        assert found is not None and int(found[1]) > 100, said
    assert "_csv (" in said
    (recorded,) = (arm.home / "biosensor-gateway-try").glob("*.xdf")
    here = Installed(tmp_path / "pc", wheel)
    report = json.loads(here.run("xdf", "check", "--json", str(recorded), codes=(0, 1)))
    wrong = [each for each in report["findings"] if each["level"] == "error"]
    assert not BY_PROCESSOR & {each["code"] for each in wrong}, wrong


def test_a_recording_is_exported_as_on_other_computers(
    arm: Arm64, wheel: Path, tmp_path: Path
) -> None:
    agent = arm.start("run", "--simulate", "polar_h10,shimmer3_gsr")
    # An agent that has ended is not waited for; how long one takes is the computer's matter.
    while "ready: " not in arm.run("wait-ready", "--timeout", "30", codes=(0, 1)):
        assert agent.poll() is None, arm.ended(agent)
    start = ("record", "start", "--here", "--file", "study.xdf", "--timeout", "600")
    while "recording to" not in arm.run(*start, codes=(0, 1)):
        assert agent.poll() is None, arm.ended(agent)
    arm.run("record", "stop")
    arm.run("stop", "--timeout", str(LIMIT_S))
    arm.ended(agent)
    recorded = tmp_path / "study.xdf"
    recorded.write_bytes((arm.home / "study.xdf").read_bytes())
    here = Installed(tmp_path / "pc", wheel)
    here.run("xdf", "check", str(recorded))
    for each in FORMATS:
        arm.run("xdf", "export", "study.xdf", "--to", each)
        here.run("xdf", "export", str(recorded), "--to", each)
        assert _made(arm.home) == _made(tmp_path), each


def _made(folder: Path) -> dict[str, bytes]:
    """Return what was made beside a recording."""
    return {
        str(each.relative_to(folder)): each.read_bytes()
        for place in folder.glob("study_*")
        for each in (place.rglob("*") if place.is_dir() else (place,))
        if each.is_file()
    }
