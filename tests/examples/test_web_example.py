"""The experiment in jsPsych, as it stands, in a real browser with jsPsych's own files."""

from __future__ import annotations

import shutil
from collections.abc import Generator
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.page.conftest import DEADLINE_S
from tests.page.web_lab import MarkerReader, WebLab
from tests.rigs.chromium import chromium

EXAMPLE = Path(__file__).parents[2] / "examples" / "jspsych" / "reaction_time.html"
LIBRARY = Path(__file__).parent / "jspsych"
TRIALS = 5

pytestmark = pytest.mark.nightly


@pytest.fixture
def lab(tmp_path: Path) -> Generator[WebLab]:
    running = WebLab(tmp_path)
    shutil.copy(EXAMPLE, running.files)
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
        page.goto(f"{lab.site.origin}/{EXAMPLE.name}{lab.key}")
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
