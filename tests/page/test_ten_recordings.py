"""Ten people, one after the other, by the page alone: each verdict is right, and so is each sample.

Between the recordings the sensors are renamed. One participant withdraws for some seconds, one
strap drops out, one file is called after somebody else, and a web experiment marks all along. The
truth is what the virtual devices have measured, and what the experiment has sent.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pylsl
import pytest
import pyxdf
from playwright.sync_api import Locator, Page, expect

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.page.experiments.experiment_server import experiment_token
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.verdict import check
from biosensor_gateway.simulation.faults import FaultKind
from tests.faults.expectations import numeric_streams
from tests.faults.matching import match
from tests.faults.recorder import Recorded
from tests.page.conftest import DEADLINE_S, Programs, Server
from tests.page.test_web_experiments import is_ready, is_right, zero_of
from tests.page.web_lab import Site, free_port
from tests.rigs.lab_client import LabProcess, Samples, settings_toml
from tests.rigs.processes import before_others

# Its verdicts are to be green, which they are not of what other programs made late.
pytestmark = [pytest.mark.nightly, pytest.mark.alone, pytest.mark.timeout(1200)]

SENSORS = {"strap": "polar_h10", "wrist": "empatica_e4"}
MARKERS = '[markers]\nbuttons = ["baseline"]\n[markers.web]\nport = {}\norigins = ["{}"]\n\n'
RECORDED_S = 8.0
"""Until clock offsets are there."""
AWAY_S = 3.0
EDGE_S = 3.0
"""The wristband sends lumps of 1.5 s, and the recorder drops what came in its last 0.5 s."""
LATE_S = {
    ("wrist", "hr"): 6.5,
    ("wrist", "ibi"): 6.5,
    ("wrist", "gsr"): 2.0,
    ("wrist", "st"): 2.0,
}
"""So late the wristband tells of a beat, of conductance and temperature by a lump, and others of
what they measure by a second. When the participant withdraws, what has not come by then is
withheld, too."""
NEAR_S = 0.1
"""How far a stamp is at most from when the sample was measured, usually; another person's recording
is further away."""
GREEN = re.compile(r"^\d+ streams, \d+\.\d s: all is there$")
AMBER = re.compile(
    r"^\d+ streams, \d+\.\d s: the file is intact, but \d+ things? happened that the analysis must "
    r"consider$"
)
RED = re.compile(r"^\d+ streams, \d+\.\d s: 1 thing is wrong or missing in the file$")
TONES = {"green": "good", "amber": "warn", "red": "bad"}

expect.set_options(1000 * DEADLINE_S)
_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


class Session(NamedTuple):
    """One recording: who wore the sensors, its file, when it ran, and what was said of it."""

    participant: str
    file: Path
    # begun, ended: from when on the page said that it records all streams, until when it did; LSL
    # times in s.
    begun: float
    ended: float
    # From when to when a part of it may be missing, by LSL's clock; empty if none may.
    away: tuple[tuple[str, float, float], ...]
    # What the experiment marked, with its own time and the answer that it got.
    marked: tuple[tuple[float, dict[str, Any]], ...]
    verdict: Mapping[str, Any]  # As the server has it; the page's words are compared with it.


class Study:
    """An experimenter at the page, an experiment in another window, and the sensors."""

    def __init__(self, server: Server, lab: LabProcess, page: Page, trial: Page) -> None:
        self._server, self._lab, self._page, self.trial = server, lab, page, trial
        cookies = map(dict, page.context.cookies())
        self._cookie = "; ".join(f"{each['name']}={each['value']}" for each in cookies)
        self._panel = page.get_by_role("region", name="Recording")
        self.sessions: list[Session] = []
        self.paused = self.resumed = 0.0

    def record(
        self,
        participant: str,
        during: Callable[[], tuple[tuple[str, float, float], ...]] = tuple,
        called: str = "",
    ) -> Session:
        """Have somebody wear the sensors, record them, and read the verdict."""
        name = self._panel.get_by_label("Participant now")
        if name.input_value() != participant:
            name.fill(participant)
            self._panel.get_by_role("button", name=f"Set all sensors to {participant}").click()
            expect(self._page.get_by_role("heading", name=participant)).to_be_visible()
        for card in self._page.locator(".card").all():
            expect(card.locator(".state.good")).to_be_visible()
        name.fill(called or participant)
        self._panel.get_by_role("button", name="Record", exact=True).click()
        if called:
            question = self._page.get_by_role("dialog", name="Who wears the sensors?")
            question.get_by_role("button", name="Record as it is").click()
        expect(self._panel.get_by_role("button", name="Stop recording")).to_be_visible()
        standing = self._panel.locator(".state")
        if called:
            # It is said from the begin, and nothing else is.
            expect(standing).to_contain_text("recording, but something is wrong")
            said = self._panel.get_by_role("alert").get_by_role("listitem")
            expect(said).to_have_count(1)
            expect(said).to_contain_text(f"the file is called {called}")
        else:
            expect(standing).to_contain_text("recording, all streams are growing")
            expect(standing).to_have_class(re.compile("good"))
        begun = pylsl.local_clock()
        marked = self._mark(participant, "begin")
        away = during()
        time.sleep(RECORDED_S)
        marked += self._mark(participant, "end")
        # The recorder takes samples in twice a second, and not once more when it stops.
        time.sleep(1.5)
        ended = pylsl.local_clock()
        self._panel.get_by_role("button", name="Stop recording").click()
        expect(self._panel.get_by_role("button", name="Record", exact=True)).to_be_visible()
        if called:
            name.fill(participant)
        verdict = self._verdict()
        session = Session(
            participant, Path(verdict["file"]), begun, ended, away, tuple(marked), verdict
        )
        self.sessions.append(session)
        return session

    def drop_out(self) -> tuple[tuple[str, float, float], ...]:
        """Cut the strap's link for some seconds."""
        began = pylsl.local_clock()
        self._lab.apply("strap", FaultKind.DROP.value, AWAY_S)
        card = self._card("polar_h10/STRAP")
        expect(card.locator(".state.good")).to_have_count(0)
        expect(self._panel.get_by_role("alert")).to_contain_text("P03's Polar H10")
        expect(card.locator(".state.good")).to_be_visible()
        # It stays said, though all is well again.
        expect(self._panel.get_by_text("1 gap so far").first).to_be_visible()
        return (("strap", began, pylsl.local_clock()),)

    def withdraw(self) -> tuple[tuple[str, float, float], ...]:
        """Pause the wristband for some seconds, as a participant may ask for."""
        self._card("empatica_e4/WRIST").get_by_role("button", name="Traces and details").click()
        # Each stream has samples from before: lumps that have not come are withheld.
        time.sleep(EDGE_S)
        began = pylsl.local_clock()
        self._page.get_by_role("button", name="Pause (withdrawal)").click()
        expect(self._page.get_by_role("button", name="Resume")).to_be_visible()
        self.paused = pylsl.local_clock()
        time.sleep(AWAY_S)
        self.resumed = pylsl.local_clock()
        self._page.get_by_role("button", name="Resume").click()
        expect(self._page.get_by_role("button", name="Pause (withdrawal)")).to_be_visible()
        self._page.get_by_role("button", name="Back to all devices").click()
        expect(self._card("empatica_e4/WRIST").locator(".state.good")).to_be_visible()
        return (("wrist", began, pylsl.local_clock()),)

    def truth(self, key: str) -> dict[str, Samples]:
        return self._lab.truth(key)

    def _card(self, device: str) -> Locator:
        return self._page.locator(f'[data-device="{device}"]')

    def _mark(self, participant: str, note: str) -> list[tuple[float, dict[str, Any]]]:
        told: tuple[float, dict[str, Any]] = self.trial.evaluate(
            """async ([marker, note]) => {
              const at = performance.now();
              return [at, await markers.mark(marker, { note, at })];
            }""",
            ["trial", f"{participant} {note}"],
        )
        return [(told[0], told[1])]

    def _verdict(self) -> Mapping[str, Any]:
        answer = self._server.request("GET", "/api/v1/status", self._cookie)
        verdict = json.loads(answer.body)["recording"]["verdict"]
        shown = self._panel.locator(".verdict p.state")
        expect(shown).to_have_class(re.compile(rf"\b{TONES[verdict['colour']]}\b"))
        expect(shown).to_contain_text(verdict["sentence"])
        expect(self._panel.locator(".verdict .file")).to_have_text(verdict["file"])
        return verdict


@pytest.fixture
def study(programs: Programs, window: Callable[..., Page], tmp_path: Path) -> Generator[Study]:
    options = {"seed": 7}
    devices = [{"key": key, "sensor": each, "options": options} for key, each in SENSORS.items()]
    with LabProcess(devices, tmp_path) as lab, ExitStack() as stack:
        worn = dict.fromkeys(SENSORS, 'participant = "P01"')
        programs.settings.write_text("")
        programs.call("mark", "--web", "--save", str(tmp_path / "site"))
        site = Site(tmp_path / "site")
        stack.callback(site.close)
        port = free_port()
        programs.settings.write_text(
            MARKERS.format(port, site.origin) + settings_toml(lab, SENSORS, worn)
        )
        programs.environment_more.update(lab.environment)
        server = Server(programs)
        # Agent and recorder are started by it: what they miss is not to be a busy computer's fault.
        before_others(server.process.pid)
        page, trial = window(), window()
        page.goto(server.address)
        page.get_by_role("button", name="Start streaming").click()
        trial.goto(
            f"{site.origin}/experiment.html#gateway={experiment_token(programs.folder)}&port={port}"
        )
        is_ready(trial)
        page.get_by_label("Folder").fill(str(tmp_path / "recordings"))
        # Until the agent answers, nobody knows who wears its sensors.
        expect(page.get_by_label("Participant now")).to_have_value("P01")
        yield Study(server, lab, page, trial)


def loaded(file: Path) -> dict[str, dict[str, Any]]:
    """Return the streams of a file by source_id, as the agent has sent them."""
    streams, _ = _load_xdf(str(file), synchronize_clocks=False, dejitter_timestamps=False)
    found = {each["info"]["source_id"][0]: each for each in streams}
    assert len(found) == len(streams), "a stream was recorded as two"
    return found


def require_truth(
    session: Session, streams: Mapping[str, dict[str, Any]], truths: Mapping[str, Any]
) -> int:
    """Every sample is the device's, in order and once, and none between them is missing."""
    compared = 0
    for key, sensor in SENSORS.items():
        identity = DeviceIdentity(sensor, key.upper(), session.participant)
        missing_may_be = [(begin, end) for who, begin, end in session.away if who == key]
        for name in sorted(numeric_streams(sensor) & truths[key].keys()):
            stream = streams[naming.source_id(identity, name)]
            times = np.asarray(stream["time_stamps"], np.float64)
            truth: Samples = truths[key][name]
            if not len(times):
                assert declaration(sensor).stream(name).rate == 0, name
                continue
            values = np.asarray(stream["time_series"], np.float64).reshape(len(times), -1)
            places = match(Recorded(times, values, times), truth)
            compared += len(places)
            late_s = LATE_S.get((key, name), 1.0)
            for at in np.flatnonzero(np.diff(places) > 1):
                begin, end = truth.times[places[at] + 1], truth.times[places[at + 1] - 1]
                is_away = (b - late_s <= begin and end <= e + 1 for b, e in missing_may_be)
                assert any(is_away), (session.participant, name, begin, end, missing_may_be)
            if declaration(sensor).stream(name).rate:
                assert np.median(np.abs(times - truth.times[places])) < NEAR_S, name
                assert times[0] < session.begun, name
                assert times[-1] > session.ended - EDGE_S, name
    return compared


def require_markers(session: Session, streams: dict[str, dict[str, Any]], zero: float) -> None:
    """The experiment's markers are those that were sent, each when it was."""
    (key,) = (each for each in streams if each.endswith("-markers"))
    told = [json.loads(text) for (text,) in streams[key]["time_series"]]
    found = [each for each in told if each["marker"] == "trial"]
    assert [each["note"] for each in found] == [
        f"{session.participant} begin",
        f"{session.participant} end",
    ]
    for each, (at_ms, answer) in zip(found, session.marked, strict=True):
        assert each["id"] == answer["id"]
        is_right(each, zero, at_ms)


def warned(session: Session) -> list[str]:
    """What is wrong with a recording, or was; the page has said each of it."""
    found = [each for each in check(session.file).findings if each.level is not Level.NOTE]
    said = [f"{each.stream}: {each.text}" if each.stream else each.text for each in found]
    assert set(said) <= set(session.verdict["findings"])
    return said


def test_of_ten_people_each_verdict_is_right_and_no_sample_is_lost_or_wrong(study: Study) -> None:
    study.record("P01")
    study.record("P02")
    study.record("P03", during=study.drop_out)
    study.record("P04", during=study.withdraw)
    study.record("P05", called="P99")
    for number in range(6, 11):
        study.record(f"P{number:02}")

    assert [each.verdict["colour"] for each in study.sessions] == [
        *("green", "green", "amber", "amber", "red"),
        *["green"] * 5,
    ], [each.verdict for each in study.sessions]
    sentences = {"green": GREEN, "amber": AMBER, "red": RED}
    for each in study.sessions:
        assert sentences[each.verdict["colour"]].match(each.verdict["sentence"])
    dropped, withdrawn, wrong = study.sessions[2:5]
    assert warned(dropped)[0].startswith("polar_h10/STRAP of P03 was not connected from ")
    assert all("P03" in each and "STRAP" in each for each in warned(dropped))
    assert warned(withdrawn)[0].startswith("empatica_e4/WRIST of P04 was paused from ")
    assert all("P04" in each and "WRIST" in each for each in warned(withdrawn))
    assert warned(wrong) == ["the file is called P99, but its sensors are worn by P05"]
    assert [each.file.name.partition("_")[0] for each in study.sessions] == [
        *("sub-P01", "sub-P02", "sub-P03", "sub-P04", "sub-P99"),
        *(f"sub-P{number:02}" for number in range(6, 11)),
    ]

    zero = zero_of(study.trial)
    truths = {key: study.truth(key) for key in SENSORS}
    compared = 0
    for each in study.sessions:
        # Whoever judges the file later comes to the same.
        assert check(each.file).colour == each.verdict["colour"]
        streams = loaded(each.file)
        people = {key.partition("@")[0] for key in streams if "@" in key}
        assert people == {each.participant}
        require_markers(each, streams, zero)
        compared += require_truth(each, streams, truths)
    assert compared > 10 * RECORDED_S * (130 + 64)
    withheld = loaded(withdrawn.file)["P04@empatica_e4-bvp"]["time_stamps"]
    assert not any(study.paused < each < study.resumed for each in withheld)
