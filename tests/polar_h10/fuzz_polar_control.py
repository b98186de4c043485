"""Answers of the PMD control point, and the start command that they lead to.

Nothing raises; a start command names one value of each setting, of those offered.
"""

from __future__ import annotations

from collections.abc import Mapping

from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import (
    Measurement,
    Reply,
    Setting,
    Stopped,
    choose,
    parse_features,
    parse_indication,
    parse_settings,
    start,
)
from tests.fuzz.breaking import Fault, instead
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, counted
from tests.fuzz.streams import counted_pieces
from tests.polar_h10.pmd_vectors import pmd_vectors

_WANTED = {Setting.SAMPLE_RATE: 130, Setting.RESOLUTION: 14, Setting.RANGE: 8}


def check(data: bytes) -> None:
    """Read the packets in their order; parameters may go on in the next one."""
    parameters = b""
    for piece in counted_pieces(data):
        ensure(parse_features(piece) <= set(range(16)), "no such measurement", piece)
        said = parse_indication(piece)
        if isinstance(said, Stopped):
            ensure(len(said.measurements) < len(piece), "more stopped than was said", said)
        if isinstance(said, Reply):
            ensure(said.status_text != "", "a status without a name", said)
            parameters += said.parameters
            if not said.more:
                _start(parameters)
                parameters = b""


def _start(parameters: bytes) -> None:
    offered = parse_settings(parameters)
    chosen = choose(offered, _WANTED)
    for setting, value in chosen.items():
        ensure(value in offered[setting], "a value that is not offered", setting, value)
    command = start(Measurement.ECG, chosen)
    again = parse_settings(command[2:])
    ensure(again == {key: (value,) for key, value in chosen.items()}, "another command", command)


def seeds() -> Seeds:
    """Return what the control point says in the vectors."""
    return counted(pmd_vectors(on_data=False))


def _any_setting(offered: object, wanted: Mapping[object, int]) -> object:
    return dict(wanted)


FAULT: Fault = (
    "tests.polar_h10.fuzz_polar_control",
    "choose",
    instead(_any_setting),
)
"""How the reader is broken to see that the corpus finds it."""
