"""Nothing in what a real headband says of itself tells, once it is given away, whose it is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.muse.driver.commands import Answers
from biosensor_gateway.devices.muse.driver.driver import DRIVER
from biosensor_gateway.transports.tap import What

REAL = json.loads((Path(__file__).parent / "vectors" / "real_control_pieces.json").read_text())
PACKET_BYTES = 20


def packet(piece: str) -> Event:
    """Return a packet of text, which begins with its length and is filled up."""
    data = bytes([len(piece)]) + piece.encode()
    return Event(t=0.0, link=0, what=What.CAME, data=data.ljust(PACKET_BYTES, b"\0").hex())


@pytest.mark.parametrize("known", [(), ("2031-TZRW-1324",)])
def test_a_headbands_numbers_are_replaced_across_packets(known: tuple[str, ...]) -> None:
    events = [packet(piece) for piece in REAL["pieces"]]
    told = Redaction(lambda _: False, DRIVER.identifiers).of(events, known)
    answers, before = Answers(), REAL["expected"]
    complete = filter(None, [answers.feed(event.bytes) for event in told])
    status = next(each for each in complete if "sn" in each)
    own = before[3]
    for key in ("sn", "ma", "id", "hn"):
        assert status[key] != own[key]
        assert len(str(status[key])) == len(own[key])
    # By the first character of its serial number the driver knows the model.
    assert str(status["sn"])[:1] == "2"
    assert {key: status[key] for key in ("bp", "ts", "ps", "rc")} == {
        key: own[key] for key in ("bp", "ts", "ps", "rc")
    }
