"""What an inlet knows of its stream: the header, and whether another one is the same."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pylsl
import pytest

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl import network
from biosensor_common.lsl.header import MAX_RATE_HZ, read_core
from biosensor_common.lsl.inlet import local_clock, samples_available
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


# Queries of LSL: which can be read, and which streams fit.

READABLE = [
    "type='EEG'",
    'type="EEG"',
    "starts-with(name,'p01')",
    "type='EEG' or type='ECG'",
    "(type='EEG' or type='ECG') and not(name='x')",
    "count(desc/channels/channel) > 3",
    'contains(name, "it\'s")',
    "name='äöü'",
    "channel_count * 2 = 8",
    "true()",
]
UNREADABLE = [
    "type=",
    "'",
    "name='a",
    "type='EEG' or",
    "foo(",
    "nosuchfunction(name)",
    "(type='EEG'",
    "type='EEG')",
    "name='a') or (name='b'",
    "true()) and (true()",
    "type='EEG'\0",
    "type='EEG' type='ECG'",
    "===",
]


@pytest.mark.parametrize("query", READABLE)
def test_what_liblsl_can_read_is_a_query(query: str) -> None:
    assert network.is_query(query)


@pytest.mark.parametrize("query", UNREADABLE)
def test_what_liblsl_cannot_read_is_none_and_fits_nothing(query: str) -> None:
    assert not network.is_query(query)
    info = pylsl.StreamInfo("any", "EEG", 4, 100.0, "float32", "id")
    assert not network.matches_query(info, query.replace("\0", "'"))


@pytest.mark.parametrize(
    ("query", "fits"),
    [
        ("type='EEG'", True),
        ("type='ECG'", False),
        ("type='ECG' or name='cap'", True),
        ("starts-with(name,'ca') and channel_count=4", True),
        ("nominal_srate>100", False),
        ("desc/biosensor/participant='p01'", True),
        ("desc/biosensor/participant='p02'", False),
    ],
)
def test_a_stream_fits_by_its_fields_and_its_description(query: str, fits: bool) -> None:
    info = pylsl.StreamInfo("cap", "EEG", 4, 100.0, "float32", "id")
    info.desc().append_child("biosensor").append_child_value("participant", "p01")
    assert network.matches_query(info, query) is fits


def test_the_clock_is_that_of_lsl() -> None:
    before, between, after = pylsl.local_clock(), local_clock(), pylsl.local_clock()
    assert before <= between <= after


@pytest.mark.nightly
def test_what_an_inlet_holds_is_counted_until_it_is_pulled() -> None:
    info = pylsl.StreamInfo("held", "Test", 1, 0.0, "float32", "held-1")
    outlet = pylsl.StreamOutlet(info)
    (found,) = pylsl.resolve_byprop("source_id", "held-1", timeout=30.0)
    inlet = pylsl.StreamInlet(found, recover=False, as_numpy=True)
    assert samples_available(inlet) == 0
    inlet.open_stream(30.0)
    assert outlet.wait_for_consumers(30.0)
    outlet.push_chunk([[1.0], [2.0], [3.0]])
    deadline = time.monotonic() + 30.0
    while samples_available(inlet) < 3:
        assert time.monotonic() < deadline, "the samples never came"
        time.sleep(0.005)
    inlet.pull_sample(0.0)
    assert samples_available(inlet) == 2
