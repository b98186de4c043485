"""What is said of a device that does not stream, and since when."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import pytest

from biosensor_gateway.agent.device_states import State, absences, clock_time, names
from biosensor_gateway.devices.registry import sensor_title

STRAP = sensor_title("polar_h10")


def device(**changes: Any) -> dict[str, Any]:
    usual: dict[str, Any] = {
        "sensor": "polar_h10",
        "unit": "A1",
        "participant": "P03",
        "label": "",
        "state": "streaming",
        "paused": False,
        "error": None,
        "since": None,
        "streams": {"P03@polar_h10-ecg": {}},
    }
    return usual | changes


def at(hour: int, minute: int) -> float:
    today = datetime.now().astimezone()
    return today.replace(hour=hour, minute=minute, second=7, microsecond=0).timestamp()


def test_a_device_that_streams_is_not_named() -> None:
    assert absences([device()]) == ()


def test_a_pause_is_named_with_its_person_and_its_time() -> None:
    (found,) = absences([device(paused=True, since=at(14, 3))])
    assert found.sentence == f"P03's {STRAP} is paused since 14:03"
    assert (found.is_paused, found.is_partial) == (True, False)
    assert found.sources == {"P03@polar_h10-ecg"}


@pytest.mark.parametrize("state", [each for each in State if each is not State.STREAMING])
def test_every_other_state_is_told(state: State) -> None:
    (found,) = absences([device(state=state.value, since=at(9, 5), error="it was refused")])
    assert found.sentence.startswith(f"P03's {STRAP} ")
    assert found.sentence.endswith(" since 09:05: it was refused")
    assert not found.is_partial


def test_of_one_that_streams_in_part_the_reason_is_told() -> None:
    (found,) = absences([device(error="no data of acc")])
    assert found.sentence == f"P03's {STRAP} streams, but: no data of acc"
    assert (found.is_partial, found.sources) == (True, frozenset())


def test_an_agent_of_before_says_no_time() -> None:
    old = device(state="connecting")
    del old["since"]
    (found,) = absences([old])
    assert found.sentence == f"P03's {STRAP} is not connected"


def test_two_of_a_name_are_told_apart() -> None:
    two = [device(), device(unit="B2"), device(label="left"), device(participant="")]
    assert names(two) == [f"P03 {STRAP} A1", f"P03 {STRAP} B2", f"P03 {STRAP} left", STRAP]


def test_a_time_of_another_day_has_its_date() -> None:
    yesterday = datetime.now().astimezone() - timedelta(days=1)
    assert clock_time(yesterday.timestamp()) == f"{yesterday:%Y-%m-%d %H:%M}"
    assert clock_time(at(7, 1), seconds=True) == "07:01:07"
