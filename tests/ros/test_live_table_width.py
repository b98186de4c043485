"""The table of the demo fits a terminal of 100 columns."""

from __future__ import annotations

import json

from std_msgs.msg import String

from biosensor_common.quantities import MessageType
from biosensor_gateway.devices.registry import declaration, declaration_names
from lsl_to_ros.live_table import Row, fitted, render, widths

WIDTH = 100
HEADINGS = ("topic", "type", "Hz", "nominal", "last value", "age s", "lost")
EVENT = json.dumps({"type": "device", "what": "connected", "why": "x" * 400})
VECTOR = "-0.123 -0.0456 -9.81e-05 microvolts"


def line(topic: str, value: str) -> tuple[str, ...]:
    return (topic, "Float32MultiArray", "1024.00", "irregular", value, "12.3", "unknown")


def total(lines: list[tuple[str, ...]]) -> int:
    return sum(widths(lines)) + 2 * (len(HEADINGS) - 1)


def table(prefix: str) -> list[tuple[str, ...]]:
    topics = [
        f"/biosensors/{prefix}{name}/{stream.data_name}_chunk"
        for name in declaration_names()
        for stream in declaration(name).streams
    ]
    return [HEADINGS, *(line(topic, VECTOR) for topic in topics), line("/biosensors/e", EVENT)]


def test_names_and_units_stay_whole() -> None:
    lines = list(fitted(table(""), WIDTH))
    assert total(lines) <= WIDTH
    assert "vernier_respiration_belt/force_chunk" in [each[0] for each in lines]
    assert lines[1][4].startswith("-0.12")
    assert all(each[4].endswith(("microvolts", "...")) for each in lines[1:])
    assert lines[0][0] == "topic in /biosensors/"
    assert all(each[2:4] == ("1024.00", "irregular") for each in lines[1:])


def test_a_long_participant_shortens_the_name_last() -> None:
    lines = list(fitted(table("participant_0123_left_upper_arm/"), WIDTH))
    assert total(lines) <= WIDTH
    assert any(each[0].endswith("force_chunk") for each in lines)


def test_a_table_that_fits_is_not_cut() -> None:
    assert fitted(table(""), 200) != table("")
    assert fitted(table(""), 1000) == table("")


def test_without_a_terminal_the_table_fits_a_log() -> None:
    topics = table("")[1:]
    rows = [
        Row(each[0].removesuffix("_chunk"), MessageType.STRING, 7, last=String(data=EVENT))
        for each in topics
    ]
    rows.append(Row("/biosensors/gateway/counters", MessageType.DIAGNOSTIC_ARRAY))
    lines = render(rows).splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert lines[0].startswith("topic in /biosensors/ ")
    assert all(each.endswith("unknown") for each in lines[1:])
