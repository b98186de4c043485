"""Messages by their names, and those of text."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from std_msgs.msg import Empty, Header, String

from biosensor_common.device_clock import ClockState
from biosensor_common.quantities import MessageType
from biosensor_common.ros.texts import clock_of, counters_message, raw_text, read_counters, text_of
from biosensor_common.topic_shape import chunk_type
from biosensor_gateway.streaming.counters import Counters, counters_text
from lsl_to_ros.topics.outputs import CLASSES

# ROS ends a text at its first NUL, as rclpy's own objects do.
any_text = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))


@pytest.mark.parametrize("kind", MessageType)
def test_every_type_of_the_closed_set_has_its_class(kind: MessageType) -> None:
    package, _, name = kind.value.split("/")
    message_class = CLASSES[kind]
    assert message_class.__module__.startswith(f"{package}.msg.")
    assert message_class.__name__ == name


@pytest.mark.parametrize(
    ("raw", "chunk"),
    [
        (MessageType.FLOAT32, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.UINT8, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.UINT16, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.FLOAT32_MULTI_ARRAY, MessageType.FLOAT32_MULTI_ARRAY),
        (MessageType.FLOAT64_MULTI_ARRAY, MessageType.FLOAT64_MULTI_ARRAY),
        (MessageType.INT32_MULTI_ARRAY, MessageType.INT32_MULTI_ARRAY),
        (MessageType.INT64_MULTI_ARRAY, MessageType.INT64_MULTI_ARRAY),
    ],
)
def test_a_chunk_keeps_the_precision_of_its_samples(raw: MessageType, chunk: MessageType) -> None:
    assert chunk_type(raw) is chunk


def samples(*texts: str) -> list[Any]:
    """Return one sample as a list and as what an inlet delivers."""
    return [list(texts), np.array(texts, object)]


def sent(kind: MessageType, sample: Any) -> Any:
    """Return what a subscriber gets of a sample of text."""
    message = raw_text(kind, text_of(sample))
    return deserialize_message(message, CLASSES[kind])


@given(text=any_text)
def test_a_single_text_goes_as_it_is(text: str) -> None:
    for sample in samples(text):
        assert sent(MessageType.STRING, sample) == String(data=text)


@given(texts=st.lists(any_text, min_size=2, max_size=5))
def test_several_texts_can_be_told_apart(texts: list[str]) -> None:
    for sample in samples(*texts):
        assert json.loads(sent(MessageType.STRING, sample).data) == texts


def test_an_event_without_text_only_says_that_it_came() -> None:
    assert sent(MessageType.EMPTY, ["pressed"]) == Empty()


def test_counters_become_a_diagnostic_array() -> None:
    counters = {
        "zephyr-1-ecg": Counters(pushed=250, lost=3, last_stamp=12.5),
        "a": Counters(pushed=1),
    }
    message = counters_message(17_250_000_000, counters_text(counters))
    statuses = [
        DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=name,
            values=[
                KeyValue(key="pushed", value=pushed),
                KeyValue(key="lost", value=lost),
                KeyValue(key="last_stamp", value=last),
            ],
        )
        for name, pushed, lost, last in (
            ("zephyr-1-ecg", "250.0", "3.0", "12.5"),
            ("a", "1.0", "0.0", "0.0"),
        )
    ]
    header = Header(stamp=Time(sec=17, nanosec=250_000_000))
    expected = DiagnosticArray(header=header, status=statuses)
    assert deserialize_message(message, DiagnosticArray) == expected


def test_what_the_agent_writes_is_read_again() -> None:
    written = {
        "zephyr-1-ecg": Counters(pushed=2**40, lost=3, last_stamp=123456.789012345),
        "zephyr-1-hr": Counters(),
    }
    read = read_counters(counters_text(written))
    assert read == {
        source_id: {"pushed": its.pushed, "lost": its.lost, "last_stamp": its.last_stamp}
        for source_id, its in written.items()
    }


def test_a_device_s_clock_comes_with_the_counters_of_one_of_its_streams() -> None:
    clock = ClockState(-1795230819.108032, 3.18, 0.000271, 1, 9)
    text = counters_text({"a": Counters(), "b": Counters()}, {"a": clock})
    read = read_counters(text)
    assert clock_of(read["a"]) == {
        "offset_s": -1795230819.108032,
        "drift_ppm": 3.18,
        "residual_rms_s": 0.000271,
        "reanchors": 1,
    }
    assert clock_of(read["b"]) == {}


@pytest.mark.parametrize("clock", ["null", "3", '{"offset_s": NaN}'])
def test_a_clock_that_no_agent_writes_is_a_value_error(clock: str) -> None:
    text = f'{{"a": {{"pushed": 1, "lost": 0, "last_stamp": 0, "clock": {clock}}}}}'
    with pytest.raises(ValueError, match=r".+"):
        read_counters(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "not JSON",
        "[]",
        "3",
        '{"a": 1}',
        '{"a": {}}',
        '{"a": {"pushed": null, "lost": 0, "last_stamp": 0}}',
        '{"a": {"pushed": "many", "lost": 0, "last_stamp": 0}}',
        '{"a": {"pushed": NaN, "lost": 0, "last_stamp": 0}}',
        '{"a": {"pushed": 1e999, "lost": 0, "last_stamp": 0}}',
        '{"a": {"pushed": 1' + "0" * 400 + ', "lost": 0, "last_stamp": 0}}',
        "[" * 100_000,
    ],
    ids=lambda text: text[:40] or "empty",
)
def test_what_no_agent_writes_is_a_value_error(text: str) -> None:
    with pytest.raises(ValueError, match=r".+"):
        read_counters(text)


@given(text=st.text())
def test_reading_counters_raises_nothing_else(text: str) -> None:
    with suppress(ValueError):
        read_counters(text)
