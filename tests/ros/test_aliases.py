"""Names that a user gives to sensors of other programs' streams."""

from __future__ import annotations

from dataclasses import replace

import pytest

from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields, StreamHeader, foreign_header
from lsl_to_ros.parameters.node import ALIASES, aliases_of, fault
from lsl_to_ros.routing import renamed

MUSE = "Muse (00:55:DA:B7:1A:2B)"


def foreign(name: str) -> StreamHeader:
    return foreign_header(CoreFields(name, "EEG", "id", "pc", 4, 256.0, ChannelFormat.FLOAT32))


@pytest.mark.parametrize(
    ("given", "name", "sensor"),
    [
        ([f"{MUSE}=muse_left"], MUSE, "muse_left"),
        (["Muse*=muse", "*=other"], MUSE, "muse"),
        (["Muse (00:*=muse", f"{MUSE}=second"], MUSE, "muse"),
        (["*1A:2B) = muse"], MUSE, "muse"),
        (["a=b=c"], "a=b", "c"),
        (["Muse=muse"], MUSE, MUSE),
        (["Muse.*=muse"], MUSE, MUSE),
        ([""], MUSE, MUSE),
    ],
)
def test_the_first_name_that_fits_whole_holds(given: list[str], name: str, sensor: str) -> None:
    header = renamed(foreign(name), name, aliases_of(given))
    assert header.identity.sensor == sensor
    assert replace(header, identity=foreign(name).identity) == foreign(name)


def test_streams_of_agents_keep_their_names() -> None:
    header = replace(foreign(MUSE), foreign=False)
    assert renamed(header, MUSE, {"*": "mine"}) == header


@pytest.mark.parametrize(
    "given", ["muse", "=muse", "Muse=", "Muse=1muse", "Muse=my muse", "Muse=a__b", "Muse=a/b"]
)
def test_what_cannot_be_a_name_is_refused(given: str) -> None:
    assert "UN-2019*=unicorn" in (fault(ALIASES, [given]) or "")


@pytest.mark.parametrize("given", [[], [""], ["Muse=muse"], ["Muse*=muse_2", f"{MUSE}=M"]])
def test_what_can_be_one_is_not(given: list[str]) -> None:
    assert fault(ALIASES, given) is None
