"""The examples of LSL, recordings, PsychoPy, jsPsych and the robot's tutorial, as they stand."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path

import numpy as np
import pylsl
import pytest
from playwright.sync_api import expect

from tests.page.conftest import DEADLINE_S, Programs
from tests.page.web_lab import MarkerReader, WebLab
from tests.rigs.chromium import chromium
from tests.xdf import xdf_file

pytestmark = pytest.mark.nightly

# The examples of LSL and of recordings, as they stand, in processes of their own.

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def programs(tmp_path: Path) -> Generator[Programs]:
    running = Programs(tmp_path)
    running.settings.write_text("")
    yield running
    running.end()


def output(path: str, *arguments: str) -> str:
    command = [sys.executable, str(EXAMPLES / path), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_stream_is_read_with_its_unit_and_rate(programs: Programs) -> None:
    programs.start("run", "--simulate", "polar_h10@P01")
    # Found by a program that does not wait for the agent's start.
    assert pylsl.resolve_byprop("type", "ECG", timeout=DEADLINE_S)
    said = output("lsl/read_a_stream.py")
    assert re.search(r"P01-polar_h10-virtual-ecg: 130 Hz, in microvolts", said), said
    measured = re.search(r"measured rate: ([\d.]+) Hz", said)
    assert measured
    assert float(measured[1]) == pytest.approx(130.0, rel=0.02)


def test_a_stream_without_a_sender_is_a_sentence() -> None:
    command = [sys.executable, str(EXAMPLES / "lsl/read_a_stream.py")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 1
    assert "No ECG on the network" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_stream_of_ones_own_is_received_with_its_times() -> None:
    sender = subprocess.Popen([sys.executable, str(EXAMPLES / "lsl/send_a_stream.py")])
    try:
        (found,) = pylsl.resolve_byprop("source_id", "my-lab-thermometer-1", timeout=DEADLINE_S)
        inlet = pylsl.StreamInlet(found, recover=False)
        received = [inlet.pull_sample(timeout=DEADLINE_S) for _ in range(20)]
        description = inlet.info(timeout=DEADLINE_S).as_xml()
        assert "<unit>celsius</unit>" in description
    finally:
        sender.kill()
        sender.wait()
    times = np.array([time for _, time in received])
    np.testing.assert_allclose(np.diff(times), 0.1, atol=1e-6)
    values = np.array([sample for sample, _ in received], float)[:, 0]
    np.testing.assert_allclose(values, 33.0 + np.sin(times), atol=1e-5)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A signal that rises by 2 each time, half a second after a marker, and a gap."""
    times = np.arange(100.0, 160.0, 0.1)
    events = (110.0, 120.0, 140.0)
    values = np.zeros(len(times))
    for event in events:
        values[(times > event + 0.45) & (times < event + 3.05)] = 2.0
    kept = (times < 121.95) | (times > 122.95)
    parts = [
        xdf_file.stream_header(1, "skin", kind="GSR", rate=10.0),
        xdf_file.stream_header(2, "marks", kind="Markers", fmt="string"),
        xdf_file.samples(1, "float32", values[kept][:, np.newaxis].tolist(), times[kept].tolist()),
        xdf_file.samples(
            2,
            "string",
            [["stimulus"], ['{"marker":"stimulus","id":1}'], ["other"], ["stimulus"]],
            [110.0, 120.0, 130.0, 140.0],
        ),
        xdf_file.footer(1, int(kept.sum())),
        xdf_file.footer(2, 4),
    ]
    path = tmp_path / "study.xdf"
    path.write_bytes(xdf_file.xdf(*parts))
    return path


def test_a_signal_is_averaged_around_its_markers(recording: Path) -> None:
    said = output(
        "recordings/average_around_markers.py",
        str(recording),
        "--signal",
        "GSR",
        "--marker",
        "stimulus",
    )
    assert "skin: 3 of 3 markers have a signal before" in said
    curve = dict(re.findall(r"^ *(-?[\d.]+) s +([+-][\d.]+|nan)$", said, re.MULTILINE))
    assert float(curve["-0.5"]) == 0.0
    assert float(curve["0.3"]) == 0.0
    # The gap behind the second marker takes nothing from the mean of the others.
    assert float(curve["2.5"]) == 2.0
    assert float(curve["4.0"]) == 0.0


def test_a_signal_that_is_not_there_is_a_sentence(recording: Path) -> None:
    program = str(EXAMPLES / "recordings/average_around_markers.py")
    command = [sys.executable, program, str(recording), "--signal", "EEG", "--marker", "stimulus"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 1
    assert "There is no EEG" in done.stderr
    assert "GSR" in done.stderr


# The robot's tutorial: its commands and its program, as they stand on the page.
ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorial-robot.md"
LIMIT_S = 240.0
_BLOCK = re.compile(r'^```(\w+) title="([^"]+)"\n(.*?)^```$', re.MULTILINE | re.DOTALL)
_WORDS = {
    "biosensor-gateway": [sys.executable, "-m", "biosensor_gateway.cli"],
    "lsl_to_ros": [sys.executable, "-m", "lsl_to_ros.node"],
    "python3": [sys.executable],
}


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


@pytest.mark.timeout(LIMIT_S + 60)
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


# The experiment in PsychoPy, as it stands, on a virtual screen with real key presses.

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
