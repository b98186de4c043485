"""``run`` at a terminal: a table below the log, and plain lines where none can be drawn."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from biosensor_gateway.agent import control
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.rigs.terminal import at_terminal

pytestmark = pytest.mark.nightly

PROGRAM = [sys.executable, "-m", "biosensor_gateway.cli"]
RUN = [*PROGRAM, "run", "--simulate", "zephyr"]
FOOT = "More, in another window: biosensor-gateway status"
STREAMING = re.compile(r"^Zephyr BioHarness 3 +streaming +(\d+\.\d) Hz +\d+ +\d+ %$", re.MULTILINE)
LOG_LINE = re.compile(r"^\d\d:\d\d:\d\d   asked to (?:pause|resume)$", re.MULTILINE)
ESCAPE = "\x1b"


def environment(folder: Path, **changes: str) -> Mapping[str, str]:
    usual = {"BIOSENSOR_GATEWAY_STATE": str(folder), "TERM": "xterm-256color"}
    kept = {key: value for key, value in os.environ.items() if key != "NO_COLOR"}
    return kept | usual | changes


def ask(folder: Path, command: str) -> None:
    control.ask(folder, command, {"device": "zephyr"}, 30.0)


@pytest.mark.seam
def test_a_table_is_renewed_in_place_below_the_log_and_ctrl_c_ends_it(tmp_path: Path) -> None:
    with at_terminal(RUN, environment(tmp_path)) as terminal:
        # Before the device's clock is found, stamps and so the rate may be wrong.
        terminal.until(lambda seen: any(200 < float(hz) < 300 for hz in STREAMING.findall(seen)))
        ask(tmp_path, "pause")
        terminal.until(lambda seen: re.search(r"^Zephyr BioHarness 3 +paused", seen, re.M))
        ask(tmp_path, "resume")
        # A key that is pressed spoils nothing.
        terminal.type("x\n")
        pictures = terminal.screen.pictures
        shown = terminal.until(
            lambda seen: terminal.screen.pictures > pictures + 3 and STREAMING.search(seen)
        )
        assert shown.count(FOOT) == 1
        assert len(STREAMING.findall(shown)) == 1
        logged = [match.start() for match in LOG_LINE.finditer(shown)]
        assert len(logged) == 2
        assert max(logged) < shown.index("Device ")
        terminal.type("\x03")
        assert terminal.exit_code() == 0
    shown = terminal.screen.text
    assert "Device " not in shown
    assert shown.rstrip().endswith("Ended. Nothing is streamed any more.")
    # The file has what it always had.
    entries = [json.loads(line) for line in (tmp_path / LOG_FILE_NAME).read_text().splitlines()]
    commands = [each["command"] for each in entries if each["event"] == "a command came"]
    assert commands == ["pause", "resume"]
    assert not [each for each in entries if "for_people" in each]


def test_it_fits_a_window_whose_size_changes(tmp_path: Path) -> None:
    size = {"columns": 46, "lines": 10}
    with at_terminal(RUN, environment(tmp_path), **size) as terminal:
        terminal.until_seen("Press Ctrl-C")
        # Its widest lines were wider.
        terminal.resize(30, 10)
        pictures = terminal.screen.pictures
        terminal.until(lambda _seen: terminal.screen.pictures > pictures + 3)
        terminal.resize(100, 30)
        terminal.until(STREAMING.search)
        pictures = terminal.screen.pictures
        shown = terminal.until(lambda _seen: terminal.screen.pictures > pictures + 3)
        assert len(STREAMING.findall(shown)) == 1
        terminal.type("\x03")
        assert terminal.exit_code() == 0


@pytest.mark.parametrize(
    ("variables", "moves", "colours"),
    [({}, True, True), ({"NO_COLOR": "1"}, True, False), ({"TERM": "dumb"}, False, False)],
    ids=["colours", "NO_COLOR", "dumb"],
)
def test_it_gives_a_terminal_what_that_understands(
    tmp_path: Path, variables: dict[str, str], moves: bool, colours: bool
) -> None:
    with at_terminal(RUN, environment(tmp_path, **variables)) as terminal:
        terminal.until(lambda _seen: (tmp_path / control.CONTROL_FILE).exists())
        ask(tmp_path, "pause")
        terminal.until(lambda seen: "asked to pause" in seen and (FOOT in seen or not moves))
        terminal.type("\x03")
        assert terminal.exit_code() == 0
    assert ("\x1b[J" in terminal.raw) is moves
    assert bool(re.search(r"\x1b\[\d*m", terminal.raw)) is colours
    assert (ESCAPE in terminal.raw) is moves
    assert re.search(r"^\d\d:\d\d:\d\d ! .*paused", terminal.screen.text, re.MULTILINE)


_BEHIND = "import subprocess; raise SystemExit(subprocess.Popen({run!r}, process_group=0).wait())"


def test_it_does_not_draw_while_its_shell_has_put_it_behind(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _BEHIND.format(run=RUN)]
    with at_terminal(command, environment(tmp_path, NO_COLOR="1")) as terminal:
        terminal.until(lambda _seen: (tmp_path / control.CONTROL_FILE).exists())
        ask(tmp_path, "pause")
        terminal.until_seen("asked to pause")
        ask(tmp_path, "stop")
        assert terminal.exit_code() == 0
    assert ESCAPE not in terminal.raw
    assert "Ended. Nothing is streamed any more." in terminal.screen.text
