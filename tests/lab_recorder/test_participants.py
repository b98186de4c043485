"""Who wears the sensors is compared with what the file is called, before anything is recorded."""

from __future__ import annotations

from pathlib import Path

import pytest

from biosensor_common.errors import ConfigReason
from biosensor_gateway.recording.here.recording import Recording
from biosensor_gateway.recording.labrecorder.file_name import BidsLabels, Place
from biosensor_gateway.recording.labrecorder.starting import Order, require_participant
from biosensor_gateway.recording.labrecorder.streams import Presence, VisibleStream
from biosensor_gateway.recording.participants import OtherParticipantsError, Worn

SEEN = VisibleStream("P01-polar_h10-A1-ecg", "P01@polar_h10-ecg", "lab-pc")
PRESENCE = Presence((SEEN,), (), (), (Worn("polar_h10/A1", "P01"),))


def place(participant: str) -> Place:
    return Place(Path("/data"), labels=BidsLabels(participant))


@pytest.mark.parametrize(
    "order",
    [
        Order(place("P01")),
        Order(Place(file=Path("walk.xdf"))),
        Order(Place(Path("/data"))),
        Order(place("P03"), other_participants=True),
    ],
)
def test_what_agrees_or_is_confirmed_is_recorded(order: Order) -> None:
    require_participant(PRESENCE, order)


@pytest.mark.parametrize("where", [place("P03"), Place(file=Path("/data/sub-P03_task-a.xdf"))])
def test_another_participant_is_refused_and_the_option_named(where: Place) -> None:
    with pytest.raises(OtherParticipantsError, match="--other-participants") as caught:
        require_participant(PRESENCE, Order(where))
    # The command line makes exit code 2 of it.
    assert caught.value.reason is ConfigReason.WRONG_VALUE
    assert "the file is called P03, but its sensors are worn by P01" in str(caught.value)


def test_nothing_is_made_of_a_recording_that_is_refused(tmp_path: Path) -> None:
    order = Order(Place(tmp_path, labels=BidsLabels("P03")))
    recording = Recording(tmp_path / "state")
    with pytest.raises(OtherParticipantsError):
        recording.start(order, lambda: PRESENCE)
    assert list(tmp_path.rglob("*.xdf")) == []
    assert not recording.is_running
