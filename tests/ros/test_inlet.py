"""What an inlet knows of its stream: the header, and whether another one is the same."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pylsl
import pytest
from pylsl import util

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl import network
from biosensor_common.lsl.header import MAX_RATE_HZ, read_core
from biosensor_common.lsl.inlet import Block, local_clock, samples_available
from biosensor_common.lsl.predicates import EVERYTHING, of_user
from biosensor_common.refusal import Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
from lsl_to_ros.lsl.delivery import BATCH_SAMPLES
from lsl_to_ros.lsl.inlets import Inlet, InletState
from tests.rigs.lsl_streams import (
    DEADLINE_S,
    Collector,
    Open,
    Source,
    drain_until,
    inlets,
    keep_lsl_inlets,
    thread_count,
)
from tests.rigs.polling import wait_until


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


# An inlet against real outlets: every sample comes once, in order and as it is.


@pytest.fixture
def lsl_inlets(monkeypatch: pytest.MonkeyPatch) -> list[pylsl.StreamInlet]:
    return keep_lsl_inlets(monkeypatch)


@pytest.mark.seam
@pytest.mark.parametrize(
    ("channel_format", "dtype", "sample"),
    [
        ("float32", np.float32, [0.5, float("nan"), float("inf")]),
        ("double64", np.float64, [0.1, 1e300, -5e-324]),
        ("int32", np.int32, [2**31 - 1, -(2**31), 0]),
        ("int16", np.int16, [2**15 - 1, -(2**15), 0]),
        ("int8", np.int8, [127, -128, 0]),
        ("int64", np.int64, [2**63 - 1, -(2**63), 0]),
    ],
)
@pytest.mark.parametrize("count", [1, 3])
def test_numbers_of_every_format_come_as_they_are(
    open_inlet: Open, channel_format: str, dtype: type[Any], sample: list[Any], count: int
) -> None:
    source = Source(channel_format, len(sample))
    inlet, receiver = open_inlet(source.find()), Collector()
    inlet.deliver_to(receiver)
    pushed = np.array([sample] * count, dtype)
    source.await_inlet()
    source.outlet.push_chunk(pushed, [5.0 + number for number in range(count)])
    drain_until(inlet, receiver, count)
    received = np.concatenate([block.samples for block in receiver.blocks])
    assert received.dtype == dtype
    assert received.tobytes() == pushed.tobytes()
    assert receiver.stamps == [5.0 + number for number in range(count)]


@pytest.mark.seam
@pytest.mark.parametrize("count", [1, 3])
def test_text_is_decoded(open_inlet: Open, count: int) -> None:
    source = Source("string", 3)
    inlet, receiver = open_inlet(source.find()), Collector()
    inlet.deliver_to(receiver)
    source.await_inlet()
    for _ in range(count):
        source.outlet.push_sample(["Größe ☃".encode(), "Größe".encode("latin-1"), b""], 5.0)
    drain_until(inlet, receiver, count)
    assert receiver.samples == [["Größe ☃", "Größe", ""]] * count


@pytest.mark.nightly
@pytest.mark.parametrize("count", [1, BATCH_SAMPLES, BATCH_SAMPLES + 1, 30 * BATCH_SAMPLES])
def test_what_waits_in_the_inlet_is_drained_in_order(
    open_inlet: Open, lsl_inlets: list[pylsl.StreamInlet], count: int
) -> None:
    source = Source(channels=2)
    inlet, receiver = open_inlet(source.find()), Collector()
    (lsl,) = lsl_inlets
    source.push(count)
    # Nobody has to be there when a sample comes.
    wait_until(lambda: samples_available(lsl) == count, "all samples in the inlet")
    inlet.drain()
    assert receiver.count == 0
    inlet.deliver_to(receiver)
    inlet.drain()
    receiver.assert_all(0, count)
    inlet.drain()
    inlet.peek()
    assert receiver.count == count
    source.push(1)
    wait_until(lambda: samples_available(lsl) == 1, "one more")
    inlet.peek()
    receiver.assert_all(0, count + 1)


@pytest.mark.nightly
def test_a_follower_delivers_what_comes_until_it_is_not_wanted_any_more(open_inlet: Open) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector(wants_each_sample=True)
    inlet.deliver_to(receiver)
    assert inlet.wants_each_sample
    follower = threading.Thread(target=inlet.follow, args=(lambda: inlet.wants_each_sample,))
    follower.start()
    for count in (1, 1, 7, 2000, 1):
        source.push(count)
        pushed = source.pushed
        wait_until(lambda pushed=pushed: receiver.count == pushed, "all that was pushed")
    receiver.wants_each_sample = False
    assert not inlet.wants_each_sample
    follower.join(DEADLINE_S)
    assert not follower.is_alive()
    source.push(5)
    drain_until(inlet, receiver, source.pushed)
    receiver.assert_all(0, source.pushed)
    assert inlet.state is InletState.READY


@pytest.mark.nightly
def test_several_that_read_at_once_disturb_no_order(open_inlet: Open) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector()
    inlet.deliver_to(receiver)
    is_over = threading.Event()

    def repeat(work: Callable[[], None]) -> None:
        while not is_over.is_set():
            work()

    def follow_a_while() -> None:
        turns = iter(range(5))
        inlet.follow(lambda: next(turns, None) is not None and not is_over.is_set())

    threads = [
        threading.Thread(target=repeat, args=(work,))
        for work in (inlet.drain, inlet.peek, inlet.drain, follow_a_while)
    ]
    for thread in threads:
        thread.start()
    try:
        for count in [1, 3, 50, 1, 700] * 20:
            source.push(count)
        wait_until(lambda: receiver.count >= source.pushed, "all that was pushed")
    finally:
        # Else they would keep two processors busy until the last test has ended.
        is_over.set()
        for thread in threads:
            thread.join(DEADLINE_S)
    receiver.assert_all(0, source.pushed)


@pytest.mark.nightly
def test_each_sample_goes_to_one_of_several_receivers(open_inlet: Open) -> None:
    source = Source()
    inlet = open_inlet(source.find())
    receivers: list[Collector] = []
    starts: list[int] = []
    for count in (10, 2000, 1, 30):
        receiver = Collector()
        inlet.deliver_to(receiver)
        if receivers:
            assert receivers[-1].ends == [0]
        receivers.append(receiver)
        starts.append(source.pushed)
        source.push(count)
        drain_until(inlet, receiver, count)
    for receiver, start, end in zip(receivers, starts, [*starts[1:], source.pushed], strict=True):
        receiver.assert_all(start, end)
    assert receivers[-1].ends == []


@pytest.mark.nightly
def test_a_receiver_that_is_full_leaves_samples_with_lsl(
    open_inlet: Open, lsl_inlets: list[pylsl.StreamInlet]
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector(wants_each_sample=True)
    (lsl,) = lsl_inlets
    receiver.is_full = True
    inlet.deliver_to(receiver)
    follower = threading.Thread(target=inlet.follow, args=(lambda: not receiver.count,))
    follower.start()
    source.push(3)
    wait_until(lambda: samples_available(lsl) == 3, "all samples in the inlet")
    inlet.drain()
    inlet.peek()
    assert receiver.count == 0
    receiver.is_full = False
    wait_until(lambda: receiver.count == 3, "all samples")
    follower.join(DEADLINE_S)
    receiver.assert_all(0, 3)


@pytest.mark.nightly
def test_at_the_end_a_full_receiver_gets_the_rest(
    open_inlet: Open, lsl_inlets: list[pylsl.StreamInlet]
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector()
    (lsl,) = lsl_inlets
    receiver.is_full = True
    inlet.deliver_to(receiver)
    source.push(BATCH_SAMPLES + 1)
    wait_until(lambda: samples_available(lsl) == BATCH_SAMPLES + 1, "all samples in the inlet")
    inlet.stop()
    receiver.assert_all(0, BATCH_SAMPLES + 1)


def is_lost(lsl: pylsl.StreamInlet) -> bool:
    """Whether liblsl has noticed that the outlet is gone; pulls nothing."""
    try:
        lsl.time_correction(0.05)
    except util.LostError:
        return True
    except util.TimeoutError:
        return False
    return False


@pytest.mark.seam
@pytest.mark.parametrize("count", [0, 1, 23])
def test_what_lsl_drops_when_an_outlet_dies_is_counted(
    open_inlet: Open, lsl_inlets: list[pylsl.StreamInlet], warnings: list[str], count: int
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector()
    inlet.deliver_to(receiver)
    (lsl,) = lsl_inlets
    source.push(7)
    drain_until(inlet, receiver, 7)
    source.push(count)
    wait_until(lambda: samples_available(lsl) == count, "the last samples in the inlet")
    source.end()
    wait_until(lambda: is_lost(lsl), "the loss")
    assert inlet.state is InletState.READY
    inlet.drain()
    assert inlet.state is InletState.ENDING
    wait_until(lambda: inlet.state is InletState.LOST, "its end")
    assert receiver.ends == [count]
    receiver.assert_all(0, 7)
    inlet.drain()
    inlet.peek()
    inlet.follow(lambda: True)
    assert (receiver.ends, receiver.count, warnings) == ([count], 7, [])


@pytest.mark.nightly
@pytest.mark.parametrize("count", [0, 1, 3000])
def test_no_sample_is_neither_delivered_nor_counted_when_an_outlet_dies(
    open_inlet: Open, count: int
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector(wants_each_sample=True)
    inlet.deliver_to(receiver)
    follower = threading.Thread(target=inlet.follow, args=(lambda: True,))
    follower.start()
    source.push(count)
    wait_until(lambda: receiver.count == count, "all samples")
    source.end()
    wait_until(lambda: inlet.state is InletState.LOST, "the loss")
    follower.join(DEADLINE_S)
    assert not follower.is_alive()
    assert receiver.ends == [0]
    receiver.assert_all(0, count)


@pytest.mark.nightly
def test_a_receiver_that_fails_ends_the_inlet_with_a_word(
    open_inlet: Open, warnings: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source = Source()
    inlet, receiver = open_inlet(source.find()), Collector()

    def fail(_: Block) -> None:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setattr(receiver, "receive", fail)
    inlet.deliver_to(receiver)
    source.push(1)

    def has_failed() -> bool:
        inlet.drain()
        return inlet.state is InletState.FAILED

    wait_until(has_failed, "the failure")
    assert len(receiver.ends) == 1
    (sentence,) = warnings
    assert source.info.name() in sentence
    assert "by nothing" in sentence


@pytest.mark.seam
def test_a_stream_that_ends_before_it_is_open_is_lost(warnings: list[str]) -> None:
    source = Source()
    found = source.find()
    source.end()
    inlet = Inlet(found, Refusals(warnings.append))
    wait_until(lambda: inlet.state is InletState.LOST, "the end of the attempt")
    assert inlet.header is None
    assert warnings == []
    inlet.stop().join(DEADLINE_S)


@pytest.mark.nightly
def test_a_stopped_inlet_has_delivered_what_had_come_and_leaves_no_thread(
    warnings: list[str],
) -> None:
    # One each: an outlet may take an inlet that is gone for one that is there.
    sources = {True: Source(), False: Source()}
    found = {wanted: source.find() for wanted, source in sources.items()}
    python_threads, all_threads = threading.active_count(), thread_count()
    for wants_each_sample, source in sources.items():
        inlet = Inlet(found[wants_each_sample], Refusals(warnings.append))
        receiver = Collector(wants_each_sample=wants_each_sample)
        wait_until(lambda inlet=inlet: inlet.state is InletState.READY, "an inlet that is open")
        inlet.deliver_to(receiver)
        if wants_each_sample:
            threading.Thread(target=inlet.follow, args=(lambda: True,)).start()
        source.push(50)
        drain_until(inlet, receiver, 50)
        closing = inlet.stop()
        assert receiver.ends == [0]
        receiver.assert_all(0, 50)
        closing.join(DEADLINE_S)
        assert not closing.is_alive()
        inlet.drain()
        inlet.peek()
        assert (receiver.count, receiver.ends) == (50, [0])
    wait_until(lambda: threading.active_count() <= python_threads, "no thread of ours")
    wait_until(lambda: thread_count() <= all_threads, "no thread of liblsl's")
    assert warnings == []


@pytest.mark.nightly
def test_an_inlet_that_is_stopped_while_it_opens_leaves_no_thread(warnings: list[str]) -> None:
    source = Source()
    found = source.find()
    all_threads = thread_count()
    for _ in range(5):
        Inlet(found, Refusals(warnings.append)).stop().join(DEADLINE_S)
    wait_until(lambda: thread_count() <= all_threads, "no thread")
    assert warnings == []
