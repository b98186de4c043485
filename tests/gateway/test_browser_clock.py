"""The browser of the page: which one is found, and its clock."""

from __future__ import annotations

import math
import random
import sys
import tempfile
from pathlib import Path

import pytest

from biosensor_gateway.page.experiments.conversation import (
    CLOCK_DRIFT,
    EXCHANGES_NEEDED,
    BrowserClock,
    Exchange,
)
from biosensor_gateway.page.experiments.web_markers import Pace
from biosensor_gateway.system import browser
from biosensor_gateway.system.browser import apps

# The clock of a browser, from exchanges whose truth is known.

TWO_HOURS_S = 7200.0


class Browser:
    """A browser that shows its time in steps, wrong by an offset and a rate."""

    def __init__(self, offset_s: float, drift: float = 0.0, step_s: float = 0.0) -> None:
        self.offset_s = offset_s  # Its time minus LSL's.
        self._drift, self._step_s = drift, step_s

    def shows(self, now: float) -> float:
        exact = now * (1 + self._drift) + self.offset_s
        return math.floor(exact / self._step_s) * self._step_s if self._step_s else exact

    def asked(self, now: float, there_s: float, back_s: float) -> Exchange:
        """Make an exchange that takes so long on each way."""
        return Exchange(now, self.shows(now + there_s), now + there_s + back_s)


@pytest.mark.parametrize("offset_s", [0.0, TWO_HOURS_S, -1.7e9])
@pytest.mark.parametrize("drift", [0.0, 0.9 * CLOCK_DRIFT, -0.9 * CLOCK_DRIFT])
@pytest.mark.parametrize("step_s", [0.0, 1e-4, 0.1])
def test_the_truth_is_within_what_is_said(offset_s: float, drift: float, step_s: float) -> None:
    chance = random.Random(1)
    browser, clock = Browser(offset_s, drift, step_s), BrowserClock(step_s)
    now, said = 1000.0, list[float]()
    for _ in range(300):
        # One way may take most of the time: a page that is busy, or a late loop here.
        ways = chance.expovariate(1 / 0.004), chance.expovariate(1 / 0.004)
        assert clock.note(browser.asked(now, *ways))
        now += 2.0
        if not clock.is_known:
            continue
        happened = now - chance.uniform(0, 30)
        known = clock.to_lsl(browser.shows(happened))
        # A computer's numbers hold a time of 1.7e9 s to 0.2 us.
        assert abs(known.lsl_time - happened) <= known.uncertainty_s + 1e-6
        said.append(known.uncertainty_s)
    assert min(said) < 2 * step_s + 0.005


def test_nothing_is_said_before_enough_is_known() -> None:
    browser, clock = Browser(5.0), BrowserClock(0.0)
    for count in range(EXCHANGES_NEEDED):
        assert clock.newest_uncertainty_s is None
        with pytest.raises(ValueError, match="not measured yet"):
            clock.to_lsl(5.0)
        clock.note(browser.asked(float(count), 0.001, 0.001))
    assert clock.newest_uncertainty_s == pytest.approx(0.001)
    clock.reset()
    assert not clock.is_known


def test_the_quickest_exchange_counts() -> None:
    browser, clock = Browser(3.0), BrowserClock(0.0)
    for there_s, back_s in [(0.2, 0.0), (0.0, 0.3), (0.0005, 0.0003), (0.1, 0.0), (0.0, 0.05)]:
        clock.note(browser.asked(100.0, there_s, back_s))
    known = clock.to_lsl(browser.shows(100.0))
    assert known.lsl_time == pytest.approx(100.0, abs=1.1e-4)
    assert known.uncertainty_s == pytest.approx(0.0004, abs=1e-6)


@pytest.mark.parametrize("by_s", [TWO_HOURS_S, -TWO_HOURS_S, 0.05, -0.05])
def test_a_clock_that_was_set_is_noticed_and_measured_again(by_s: float) -> None:
    browser, clock = Browser(3.0, step_s=1e-4), BrowserClock(1e-4)
    for count in range(20):
        assert clock.note(browser.asked(2.0 * count, 0.001, 0.002))
    browser.offset_s += by_s
    assert not clock.note(browser.asked(40.0, 0.001, 0.002))
    assert not clock.is_known
    for count in range(EXCHANGES_NEEDED):
        assert clock.note(browser.asked(41.0 + count, 0.001, 0.002))
    known = clock.to_lsl(browser.shows(45.0))
    assert abs(known.lsl_time - 45.0) <= known.uncertainty_s


def test_a_resolution_that_nobody_has_is_not_believed() -> None:
    for said_s in (-1.0, 1e9):
        clock = BrowserClock(said_s)
        for count in range(EXCHANGES_NEEDED):
            clock.note(Exchange(count, count, count))
        uncertainty = clock.newest_uncertainty_s
        assert uncertainty is not None
        assert 0 <= uncertainty < 1


# Where browsers are that can show a page in a window of its own.
def test_browsers_of_a_mac_are_found_in_its_folders_of_applications(tmp_path: Path) -> None:
    everybody, own = tmp_path / "Applications", tmp_path / "me" / "Applications"
    edge = everybody / "Microsoft Edge.app" / "Contents" / "MacOS" / "Microsoft Edge"
    chrome = own / "Google Chrome.app" / "Contents" / "MacOS" / "Google Chrome"
    for program in (edge, chrome):
        program.parent.mkdir(parents=True)
        program.touch()
    # What is left of a removed one is none.
    (everybody / "Chromium.app" / "Contents").mkdir(parents=True)
    assert list(apps((everybody, own))) == [str(chrome), str(edge)]


# From where it reads the file that leads to the page.

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="there it is given the address itself")


@POSIX
def test_the_file_is_where_browsers_may_read_and_no_disk_is_full(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home, runtime, snaps = (tmp_path / each for each in ("home", "run", "snap"))
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    monkeypatch.setattr(browser, "_SNAPS", (str(snaps),))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def parent() -> Path:
        return Path(browser.way_in("http://127.0.0.1:1/door?token=x").redirect).parents[1]

    assert parent() == tmp_path
    runtime.mkdir()
    assert parent() == runtime
    snaps.mkdir()
    # No hidden folder of the home, either.
    assert parent() == home


@POSIX
def test_where_no_file_can_be_written_the_browser_is_not_given_the_address(tmp_path: Path) -> None:
    way = browser.WayIn("http://127.0.0.1:1/door?token=x", str(tmp_path / "not" / "there" / "open"))
    assert not browser.open_page(way, in_window=True)


# How many markers a page may send.


def test_a_page_sends_some_markers_at_once_and_then_as_many_as_its_pace_allows() -> None:
    now = 100.0
    pace = Pace(per_s=2.0, at_once=3, clock=lambda: now)
    assert [pace.allows() for _ in range(5)] == [True] * 3 + [False] * 2
    now += 0.4
    assert not pace.allows()
    now += 0.1
    assert [pace.allows() for _ in range(2)] == [True, False]
    # What was not used is not saved beyond what may come at once.
    now += 3600.0
    assert [pace.allows() for _ in range(4)] == [True] * 3 + [False]
