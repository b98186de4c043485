"""The robot's tutorial: its commands and its program, as they stand on the page."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.page.conftest import Programs

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorial-robot.md"
LIMIT_S = 240.0
_BLOCK = re.compile(r'^```(\w+) title="([^"]+)"\n(.*?)^```$', re.MULTILINE | re.DOTALL)
_WORDS = {
    "biosensor-gateway": [sys.executable, "-m", "biosensor_gateway.cli"],
    "lsl_to_ros": [sys.executable, "-m", "lsl_to_ros.node"],
    "python3": [sys.executable],
}

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(LIMIT_S + 60)]


@pytest.fixture
def said(tmp_path: Path) -> Generator[Path]:
    """Start what stands in each terminal; the file has what the program says."""
    blocks = {title: text for _, title, text in _BLOCK.findall(PAGE.read_text(encoding="utf-8"))}
    (tmp_path / "slow_down.py").write_text(blocks["slow_down.py"], encoding="utf-8")
    programs = Programs(tmp_path)
    programs.settings.write_text("")
    environment = os.environ | programs.environment
    running: list[subprocess.Popen[bytes]] = []
    for number in (1, 2, 3):
        first, *rest = shlex.split(blocks[f"terminal {number}"])
        with (tmp_path / f"terminal{number}.txt").open("wb") as output:
            running.append(
                subprocess.Popen(
                    [*_WORDS[first], *rest],
                    cwd=tmp_path,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                )
            )
    yield tmp_path / "terminal3.txt"
    for process in running:
        process.terminate()
    for process in running:
        process.wait(30)


def test_the_robot_is_fast_while_the_person_is_known_to_be_calm(said: Path) -> None:
    """Unknown, calm, excited, and unknown again, when the strap is away."""
    deadline = time.monotonic() + LIMIT_S
    expected = [
        r"heart rate nan, quality \S+: speed 0\.3",
        r"heart rate (5|6|7)\d, quality \S+: speed 1\.0",
        r"heart rate 1[12]\d, quality \S+: speed 0\.3",
        r"heart rate nan, quality \S+: speed 0\.3",
    ]
    while True:
        text = said.read_text()
        place = 0
        for pattern in expected:
            match = re.compile(pattern).search(text, place)
            if match is None:
                break
            place = match.end()
        else:
            return
        assert time.monotonic() < deadline, f"{pattern} did not come:\n{text}"
        time.sleep(0.5)
