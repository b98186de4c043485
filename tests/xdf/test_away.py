"""A sensor that was paused or not connected is named in the verdict."""

from __future__ import annotations

import pytest

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.recording.xdf.findings import Level
from tests.xdf.checking import codes, text_of
from tests.xdf.test_participants import heartbeat, judged, strap

STREAMING = {"polar_h10__A1": "streaming"}


def event(kind: str, at: float) -> dict[str, object]:
    return {"event": kind, "sensor": "polar_h10", "unit": "A1", "participant": "P01",
            "lsl_time": at}  # fmt: skip


@pytest.mark.parametrize("how", [("paused", "paused"), ("discovering", "not connected")])
def test_who_was_away_the_whole_time_is_named(how: tuple[str, str]) -> None:
    state, word = how
    report = judged("P01", strap("P01"), events=[heartbeat(polar_h10__A1=state)])
    assert codes(report, Level.WARNING) == {("away", "")}
    assert text_of(report, "away") == f"polar_h10/A1 of P01 was {word} the whole time"


@pytest.mark.parametrize(
    ("kinds", "said"),
    [
        (("paused", "resumed"), "paused from 5.0 s to 8.0 s"),
        (("paused", "disconnected"), "paused from 5.0 s to the end"),
        (("disconnected", "connected"), "not connected from 5.0 s to 8.0 s"),
    ],
)
def test_from_when_to_when(kinds: tuple[str, str], said: str) -> None:
    changes = [event(kinds[0], 1005.0), event(kinds[1], 1008.0)]
    events: list[object] = [heartbeat(**STREAMING), *changes]
    report = judged("P01", strap("P01"), events=events)
    assert text_of(report, "away") == f"polar_h10/A1 of P01 was {said}"


def test_of_one_that_comes_and_goes_the_rest_is_counted() -> None:
    events: list[object] = [heartbeat(**STREAMING)]
    for k in range(5):
        events += [event("disconnected", 1002.0 + 4 * k), event("connected", 1003.0 + 4 * k)]
    text = text_of(judged("P01", strap("P01"), events=events), "away")
    assert text.count("not connected") == 3
    assert text.endswith(" and 2 times more")


def test_nothing_is_said_of_one_that_streamed() -> None:
    events: list[object] = [heartbeat(**STREAMING), event("connected", 1003.0)]
    assert judged("P01", strap("P01"), events=events).is_good
    assert not codes(judged("P01", strap("P01"), events=events), Level.WARNING)


def test_one_of_which_nothing_came_is_red(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.xdf.test_participants.STAMPS", [])
    other = DeviceIdentity("zephyr", "B", "P01")
    report = judged("P01", strap("P01"), other, events=[heartbeat(polar_h10__A1="paused")])
    assert codes(report, Level.ERROR) == {("away", "")}
    assert text_of(report, "away").endswith("the whole time, and nothing of it was recorded")
