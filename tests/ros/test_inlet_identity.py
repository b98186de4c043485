"""What an inlet knows of its stream: the header, and whether another one is the same."""

from __future__ import annotations

from collections.abc import Iterator

import pylsl
import pytest

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl.header import MAX_RATE_HZ, read_core
from biosensor_common.lsl.predicates import EVERYTHING, of_user
from biosensor_common.refusal import Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
from lsl_to_ros.lsl.inlets import Inlet, InletState
from tests.rigs.lsl_streams import DEADLINE_S, Open, Source, inlets


@pytest.fixture
def warnings() -> list[str]:
    return []


@pytest.fixture
def open_inlet(warnings: list[str]) -> Iterator[Open]:
    with inlets(warnings.append) as open_:
        yield open_


@pytest.mark.seam
def test_an_own_stream_has_its_header(open_inlet: Open, warnings: list[str]) -> None:
    identity = DeviceIdentity("polar_h10", "U1", participant="p01", label="left")
    outlet = Outlet(declaration("polar_h10").stream("acc"), identity, DeviceInfo())
    (found,) = pylsl.resolve_byprop("source_id", outlet.source_id, timeout=DEADLINE_S)
    inlet = open_inlet(found)
    assert inlet.state is InletState.READY
    assert (inlet.uid, inlet.source_id) == (found.uid(), outlet.source_id)
    header = inlet.header
    assert header is not None
    assert not header.foreign
    assert (header.identity, header.data_name) == (identity, "acc")
    assert (header.labels, header.units, header.rate) == (("X", "Y", "Z"), ("g",) * 3, 50.0)
    assert warnings == []


@pytest.mark.nightly
def test_another_programs_stream_has_the_generic_one(open_inlet: Open) -> None:
    source = Source("int16", 3, 100.0)
    inlet = open_inlet(source.find())
    assert inlet.header is not None
    assert inlet.header.foreign
    assert (len(inlet.header.labels), inlet.header.rate) == (3, 100.0)


@pytest.mark.nightly
def test_an_unusable_description_is_said_and_the_stream_is_an_unknown_one(
    open_inlet: Open, warnings: list[str]
) -> None:
    info = pylsl.StreamInfo("broken", "ECG", 1, 100.0, "float32", "broken-1")
    info.desc().append_child("biosensor").append_child_value("version", "99")
    source = Source(info=info)
    inlet = open_inlet(source.find())
    assert inlet.state is InletState.READY
    assert inlet.header is not None
    assert inlet.header.foreign
    (sentence,) = warnings
    assert sentence.count("'broken'") == 1
    assert "99" in sentence


def info(name: str = "cap", kind: str = "EEG", source_id: str = "id") -> pylsl.StreamInfo:
    return pylsl.StreamInfo(name, kind, 4, 100.0, "float32", source_id)


@pytest.mark.seam
def test_another_programs_stream_continues_under_the_same_id_name_and_type(
    open_inlet: Open,
) -> None:
    source = Source(info=info())
    inlet = open_inlet(source.find())
    assert inlet.continues_as(info())
    for other in (info(name="cup"), info(kind="ECG"), info(source_id="di"), info(source_id="")):
        assert not inlet.continues_as(other)


@pytest.mark.nightly
def test_an_own_stream_continues_under_its_id_alone(open_inlet: Open) -> None:
    outlet = Outlet(
        declaration("zephyr").stream("ecg"), DeviceIdentity("zephyr", "U1"), DeviceInfo()
    )
    (found,) = pylsl.resolve_byprop("source_id", outlet.source_id, timeout=DEADLINE_S)
    inlet = open_inlet(found)
    assert inlet.continues_as(info(source_id=outlet.source_id))
    assert not inlet.continues_as(info())


@pytest.mark.nightly
def test_without_an_id_nothing_is_the_same_stream(open_inlet: Open) -> None:
    source = Source(info=info(name="nameless", source_id=""))
    (found,) = pylsl.resolve_byprop("name", "nameless", timeout=DEADLINE_S)
    assert source.outlet is not None
    assert not open_inlet(found).continues_as(info(name="nameless", source_id=""))


@pytest.mark.nightly
def test_a_query_is_answered_from_the_whole_description(open_inlet: Open) -> None:
    described = info(source_id="described")
    described.desc().append_child("biosensor-like").append_child_value("participant", "p01")
    source = Source(info=described)
    inlet = open_inlet(source.find())
    assert inlet.matches(EVERYTHING)
    assert inlet.matches(of_user("type='EEG' and desc/biosensor-like/participant='p01'"))
    assert not inlet.matches(of_user("type='ECG'"))


@pytest.mark.parametrize(
    ("channels", "rate"),
    [
        (0, 1.0),
        (4097, 1.0),
        (1, MAX_RATE_HZ * 2),
        (1, float("inf")),
        (1, float("nan")),
    ],
)
def test_an_announcement_that_cannot_be_is_refused(channels: int, rate: float) -> None:
    announced = pylsl.StreamInfo("odd one", "Test", channels, rate, "float32", "odd")
    with pytest.raises(SpecError, match="odd one") as caught:
        read_core(announced)
    assert caught.value.reason is SpecReason.INVALID
    with pytest.raises(SpecError, match="odd one"):
        Inlet(announced, Refusals(pytest.fail))
