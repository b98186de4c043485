"""Queries of LSL: which can be read, and which streams fit."""

from __future__ import annotations

import time

import pylsl
import pytest

from biosensor_common.lsl import network
from biosensor_common.lsl.inlet import local_clock, samples_available

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
