"""The experiments in PsychoPy and jsPsych, as they stand."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Generator
from pathlib import Path

import pylsl
import pytest
from playwright.sync_api import expect

from tests.page.conftest import DEADLINE_S
from tests.page.web_lab import MarkerReader, WebLab
from tests.rigs.chromium import chromium

pytestmark = pytest.mark.nightly

# The experiment in PsychoPy, as it stands, on a virtual screen with real key presses.

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "psychopy" / "reaction_time.py"
PYTHON = ROOT / ".venv-psychopy" / "bin" / "python"
TRIALS = 5


@pytest.fixture
def screen() -> Generator[dict[str, str]]:
    """Give the environment of a program on a screen of its own."""
    assert PYTHON.exists(), "make venv-psychopy"
    for program in ("Xvfb", "xdotool"):
        assert shutil.which(program), f"{program} is missing: tests/system/packages.txt"
    ready, told = os.pipe()
    command = ["Xvfb", "-displayfd", str(told), "-screen", "0", "1024x768x24", "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[told], stderr=subprocess.DEVNULL)
    os.close(told)
    with os.fdopen(ready) as numbers:
        number = numbers.readline().strip()
    yield os.environ | {"DISPLAY": f":{number}"}
    server.terminate()
    server.wait()


def test_each_trial_has_its_markers_with_times_in_order(
    screen: dict[str, str], tmp_path: Path
) -> None:
    # PsychoPy writes its preferences into the home folder.
    environment = screen | {"HOME": str(tmp_path)}
    experiment = subprocess.Popen([str(PYTHON), str(EXAMPLE)], env=environment)
    try:
        (found,) = pylsl.resolve_byprop("source_id", "psychopy-reaction-time", timeout=DEADLINE_S)
        inlet = pylsl.StreamInlet(found, recover=False)
        inlet.open_stream(DEADLINE_S)
        markers: list[tuple[str, float]] = []
        deadline = pylsl.local_clock() + DEADLINE_S
        while not markers or markers[-1][0] != "end":
            assert pylsl.local_clock() < deadline, markers
            if not markers:
                # It may not listen yet.
                press(environment, "PsychoPy")
            sample, time = inlet.pull_sample(timeout=1.0)
            if sample is None or time is None:
                continue
            markers.append((sample[0], time))
            assert time <= pylsl.local_clock()
            if sample[0].startswith("circle"):
                press(environment, "PsychoPy")
        assert experiment.wait(DEADLINE_S) == 0
    finally:
        experiment.kill()
        experiment.wait()
    names = [name for name, _ in markers]
    trials = [f"{what} {n}" for n in range(1, TRIALS + 1) for what in ("circle", "key")]
    assert names == ["begin", *trials, "end"]
    times = [time for _, time in markers]
    assert times == sorted(times)


def press(environment: dict[str, str], window: str) -> None:
    """Press the space bar in a window, once it is there.

    Without a window manager the keys go to where the pointer is.
    """
    found = ["search", "--sync", "--onlyvisible", "--name", window]
    command = ["xdotool", *found, "mousemove", "--window", "%1", "100", "100", "key", "space"]
    subprocess.run(command, env=environment, timeout=DEADLINE_S, check=True)


# The experiment in jsPsych, as it stands, in a real browser with jsPsych's own files.
WEB_EXAMPLE = Path(__file__).parents[2] / "examples" / "jspsych" / "reaction_time.html"
LIBRARY = Path(__file__).parent / "jspsych"


@pytest.fixture
def lab(tmp_path: Path) -> Generator[WebLab]:
    running = WebLab(tmp_path)
    shutil.copy(WEB_EXAMPLE, running.files)
    for script in LIBRARY.glob("*.js"):
        shutil.copy(script, running.files)
    yield running
    running.close()


def test_each_trial_has_its_markers_in_order(lab: WebLab) -> None:
    reader = MarkerReader()
    with chromium() as browser:
        page = browser.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(f"{lab.site.origin}/{WEB_EXAMPLE.name}{lab.key}")
        for trial in range(1, TRIALS + 1):
            reader.wait_for("circle on", f"trial {trial}")
            page.keyboard.press("Space")
        reader.find("end")
        expect(page.locator("body")).to_contain_text("Thank you.", timeout=1000 * DEADLINE_S)
        assert not errors
    shown, pressed = reader.named("circle on"), reader.named("key")
    assert [each["note"] for each in shown] == [f"trial {n}" for n in range(1, TRIALS + 1)]
    assert len(pressed) == TRIALS
    for circle, key in zip(shown, pressed, strict=True):
        assert circle["timed_by"] == key["timed_by"] == "clock"
        assert circle["lsl_time"] < key["lsl_time"]
