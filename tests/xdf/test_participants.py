"""A file that is called after one person and worn by another is never all right."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.naming import require_participant
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.participants import (
    Worn,
    compare,
    compare_file,
    listed,
    participant_of,
)
from biosensor_gateway.recording.recorder.request import BidsLabels
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.report import Report
from biosensor_gateway.recording.xdf.verdict import Colour, judge, verdict
from tests.xdf import xdf_file as x
from tests.xdf.checking import codes, read, text_of
from tests.xdf.own_streams import own_header

NAME = "sub-{}_ses-S001_task-walk_run-001_beh.xdf"
AGENT = DeviceIdentity("gateway", "lab-pc")
STAMPS = [1000 + k for k in range(30)]


def worn(*by: str) -> list[Worn]:
    return [Worn(f"polar_h10/{index}", name) for index, name in enumerate(by)]


@pytest.mark.parametrize(
    ("named", "by"),
    [
        ("", ["P01", "P02"]),
        ("P03", []),
        ("P03", ["", ""]),
        ("P03", ["P03", "P03", ""]),
        # As settings and recordings of earlier times have it.
        ("P03", ["P-03"]),
        ("group07", ["P01", "P02"]),
    ],
)
def test_what_agrees_is_not_asked_about(named: str, by: list[str]) -> None:
    assert compare(named, worn(*by)) is None


@pytest.mark.parametrize(
    ("named", "by", "sentence"),
    [
        ("P03", ["P01", "P02"], "but its sensors are worn by P01 and P02"),
        ("P03", ["P01", "", "P01"], "but its sensors are worn by P01"),
        # Exports would call this person P03.
        ("p03", ["P03"], "but its sensors are worn by P03"),
        ("group07", ["P01", "P01"], "but its sensors are worn by P01"),
    ],
)
def test_nobody_of_that_name_wears_a_sensor(named: str, by: list[str], sentence: str) -> None:
    found = compare(named, worn(*by))
    assert found is not None
    assert (found.is_all, found.sentence) == (True, f"the file is called {named}, {sentence}")


def test_a_file_in_lower_case_is_its_persons() -> None:
    # LabRecorder's window makes all names lower-case, so only what somebody types is compared.
    assert compare_file(Path(NAME.format("p03")), [strap("P03")]) is None
    assert compare_file(Path(NAME.format("p04")), [strap("P03")]) is not None


def test_one_sensor_of_the_person_before() -> None:
    found = compare("P05", [Worn("polar_h10/A", "P04"), Worn("zephyr/B", "P05")])
    assert found is not None
    assert (found.is_all, found.others) == (False, ("P04",))
    assert found.sentence == "the file is called P05, but P04 wears polar_h10/A"


@pytest.mark.parametrize(
    ("named", "first", "other"),
    [
        ("P01", "P01", "p01"),
        ("P01", "P-01", "P01"),
        ("Muller", "M\u00fcller", "Mu\u0308ller"),
        ("1", "\u5c71\u75301", "\u7530\u4e2d1"),
        ("con", "CON", "con"),
    ],
)
def test_two_spellings_are_two_people(named: str, first: str, other: str) -> None:
    found = compare(named, worn(first, other))
    assert found is not None
    second = first if other == named else other
    assert (found.is_all, found.others) == (False, (second,))


def test_many_names_are_a_sentence() -> None:
    assert listed([]) == ""
    assert listed(["a"]) == "a"
    assert listed("abcdefgh") == "a, b, c, d, e, f and 2 more"


@pytest.mark.parametrize(
    ("name", "participant"),
    [("sub-P03_task-a.xdf", "P03"), ("sub-P03.xdf", "P03"), ("walk_sub.xdfz", "")],
)
def test_a_files_name_says_whose_it_is(name: str, participant: str) -> None:
    assert participant_of(Path("sub-x") / name) == participant


def judged(named: str, *identities: DeviceIdentity, events: list[object] | None = None) -> Report:
    """Judge a recording of heart rates, and of what an agent says in it."""
    return judge(read(recorded(*identities, events=events), NAME.format(named)))


def recorded(*identities: DeviceIdentity, events: list[object] | None = None) -> bytes:
    """Return a recording of heart rates, and of what an agent says in it."""
    parts: list[bytes] = []
    for number, each in enumerate(identities, 1):
        parts += [
            own_header(number, each, "hr"),
            x.samples(number, "float32", [[60.0]] * len(STAMPS), [*STAMPS]),
            x.offsets(number, (1005, 1010, 1015)),
            x.footer(number, len(STAMPS)),
        ]
    if events is not None:
        texts = [[json.dumps(each)] for each in events]
        parts += [
            own_header(9, AGENT, "events"),
            x.samples(9, "string", texts, [1001.0 + k for k in range(len(texts))]),
            x.offsets(9, (1005, 1010, 1015)),
            x.footer(9, len(texts)),
        ]
    return x.xdf(*parts)


def strap(participant: str, unit: str = "A1") -> DeviceIdentity:
    return DeviceIdentity("polar_h10", unit, participant)


def test_the_verdict_is_red_if_nobody_of_that_name_wears_a_sensor() -> None:
    report = judged("P03", strap("P01"), strap("P02", "A2"))
    assert codes(report, Level.ERROR) == {("other-participants", "")}
    assert verdict(report).colour is Colour.RED
    assert "P01 and P02" in text_of(report, "other-participants")


def test_the_verdict_is_amber_if_somebody_else_wears_one_of_them() -> None:
    report = judged("P01", strap("P01"), strap("P02", "A2"))
    assert codes(report, Level.WARNING) == {("other-participants", "")}
    assert verdict(report).colour is Colour.AMBER


def test_a_group_is_a_participant_of_several_people() -> None:
    assert judged("group1", strap("P01"), strap("P02", "A2")).is_good
    assert not judged("group1", strap("P01")).is_good


def heartbeat(**devices: str) -> dict[str, object]:
    told = {name.replace("__", "/"): state for name, state in devices.items()}
    return {"event": "heartbeat", "devices": told, "lsl_time": 1001.0}


def test_a_device_of_which_nothing_was_recorded_is_red() -> None:
    states = ("connecting", "streaming")
    events: list[object] = [heartbeat(polar_h10__A1="streaming", zephyr__B=each) for each in states]
    report = judged("P01", strap("P01"), events=events)
    assert codes(report, Level.ERROR) == {("left-out", "")}
    assert text_of(report, "left-out").startswith("the agent also had zephyr/B")


def test_a_device_that_never_came_is_amber() -> None:
    report = judged("P01", strap("P01"), events=[heartbeat(zephyr__B="discovering")])
    assert codes(report, Level.WARNING) == {("absent", "")}
    assert "was never available (looking for it)" in text_of(report, "absent")


def change(kind: str, participant: str, at: float) -> dict[str, object]:
    return {"event": kind, "sensor": "polar_h10", "unit": "A1", "participant": participant,
            "lsl_time": at}  # fmt: skip


def test_a_sensor_that_was_renamed_or_removed_meanwhile_is_red() -> None:
    events: list[object] = [heartbeat(polar_h10__A1="streaming"),
                            change("device_removed", "P01", 1012.0),
                            change("device_added", "P02", 1012.5)]  # fmt: skip
    report = judged("P01", strap("P01"), events=events)
    assert codes(report, Level.ERROR) == {("removed", "")}
    text = text_of(report, "removed")
    assert text.startswith("polar_h10/A1 of P01 was removed or renamed in the settings at 12.0 s")


def test_a_sensor_that_the_agent_has_no_longer_after_a_restart_is_red() -> None:
    both = heartbeat(polar_h10__A1="streaming", polar_h10__A2="streaming")
    one = {**heartbeat(polar_h10__A1="streaming"), "lsl_time": 1012.0}
    sensors = strap("P01"), strap("P02", "A2")
    report = judged("group1", *sensors, events=[both, one])
    assert codes(report, Level.ERROR) == {("removed", "")}
    text = text_of(report, "removed")
    assert text.startswith("polar_h10/A2 of P02 was removed or renamed in the settings at 12.0 s")
    assert judged("group1", *sensors, events=[both, one, both]).is_good


def test_a_sensor_that_comes_back_under_its_name_is_all_right() -> None:
    events: list[object] = [change("device_removed", "P01", 1012.0),
                            change("device_added", "P01", 1012.5), "no event"]  # fmt: skip
    assert judged("P01", strap("P01"), events=events).is_good


@pytest.mark.parametrize("name", ["P-01", "p 1", "", "Müller", "../x", "x" * 33])
def test_one_rule_for_names(name: str) -> None:
    for take in (require_participant, BidsLabels):
        with pytest.raises(ConfigError, match="letters and digits") as caught:
            take(name)
        assert caught.value.reason is ConfigReason.WRONG_VALUE
    assert require_participant("P01") == BidsLabels("P01").participant


def test_a_refused_name_comes_with_one_that_is_taken() -> None:
    with pytest.raises(ConfigError, match=r"such as P01$"):
        require_participant("P-01")
