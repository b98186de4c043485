"""What the agent said of late, refused and jumping data stands in the verdict."""

from __future__ import annotations

import pytest

from biosensor_gateway.recording.xdf.counters import Reading, refusals
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.streaming.events import EventKind
from tests.xdf.checking import codes, text_of
from tests.xdf.test_away import STREAMING, event
from tests.xdf.test_participants import heartbeat, judged, strap

LATE = "2 samples had waited with others"


def test_a_silence_is_told_with_its_longest() -> None:
    silent = event(EventKind.STREAMS_SILENT, 1008.0)
    events: list[object] = [
        heartbeat(**STREAMING),
        silent | {"seconds": 5.2, "streams": ["acc", "ecg"]},
        silent | {"seconds": 9.8, "streams": ["ecg"], "lsl_time": 1012.0},
    ]
    report = judged("P01", strap("P01"), events=events)
    assert codes(report, Level.WARNING) == {("silent", "")}
    text = text_of(report, "silent")
    assert text.startswith("polar_h10/A1 of P01 ")
    assert "2 times, for ecg 9.8 s until 12.0 s" in text


@pytest.mark.parametrize(("seconds", "is_told"), [(-6.87, True), (None, False)])
def test_a_jump_is_told_unless_nothing_was_stamped_before_it(
    seconds: float | None, is_told: bool
) -> None:
    jump = event(EventKind.CLOCK_REANCHORED, 1008.0)
    events: list[object] = [
        heartbeat(**STREAMING),
        jump | ({} if seconds is None else {"seconds": seconds}),
    ]
    report = judged("P01", strap("P01"), events=events)
    assert codes(report, Level.WARNING) == ({("clock-jumped", "")} if is_told else set())
    if is_told:
        text = text_of(report, "clock-jumped")
        assert "polar_h10/A1 of P01 jumped by -6.870 s at 8.0 s" in text


def test_nothing_is_said_of_a_sensor_that_is_not_in_the_file() -> None:
    other = event(EventKind.CLOCK_REANCHORED, 1008.0) | {"sensor": "zephyr", "seconds": 2.0}
    report = judged("P01", strap("P01"), events=[heartbeat(**STREAMING), other])
    assert not codes(report, Level.WARNING)


FULL = "connected, but the device refuses hr (/Meas/HR is refused (507): it has no room)"


@pytest.mark.parametrize(
    ("problems", "said"),
    [
        ({"what": FULL}, FULL),
        ({"what": "3 bytes could not be read", "last": 1009.0}, "3 bytes could not be read"),
        # It was before the recording, and is told for some seconds.
        ({"what": "3 bytes could not be read", "last": 990.0}, None),
        ("no problem", None),
    ],
)
def test_what_a_device_refuses_is_told_of_the_device(problems: object, said: str | None) -> None:
    told = heartbeat(**STREAMING) | {"problems": {"polar_h10/A1": [problems]}}
    later = told | {"lsl_time": 1010.0}
    report = judged("P01", strap("P01"), events=[told, later])
    assert codes(report, Level.WARNING) == ({("refused", "")} if said else set())
    if said:
        assert text_of(report, "refused") == f"polar_h10/A1 of P01: {said}"


def reading(at: float, *sentences: str) -> Reading:
    return Reading(0, 0, at, told_at=at, refused=sentences)


@pytest.mark.parametrize(
    ("readings", "told"),
    [
        ([reading(0.0), reading(1.0, LATE)], [LATE]),
        # Of one kind the newest.
        ([reading(0.0), reading(1.0, LATE), reading(2.0, "5" + LATE[1:])], ["5" + LATE[1:]]),
        # It was before, and is shown for ten seconds.
        ([reading(0.0, LATE), reading(9.0, LATE), reading(11.0)], []),
        # What stays is of now.
        ([reading(0.0, LATE), reading(11.0, LATE)], [LATE]),
    ],
)
def test_which_sentences_are_of_the_recording(readings: list[Reading], told: list[str]) -> None:
    assert refusals(readings) == told
