"""What settings of line sensors declare, and the counts and times of their boards."""

from __future__ import annotations

from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import ConfigError
from biosensor_common.quantities import ContentType, MessageType
from biosensor_gateway.devices.line_sensor import column
from biosensor_gateway.devices.line_sensor.driver.emitter import LineEmitter, Order, Unwrapped
from biosensor_gateway.devices.registry import declared, settings_models
from biosensor_gateway.settings.file import settings_of
from tests.line_sensor.conftest import line_settings
from tests.rigs.emitter_sink import EmitterSink

# What settings of line sensors declare, and what is said of those that cannot be.

HEAD = '[[device]]\nsensor = "line_sensor"\nudp_port = 5005\n'


def test_each_stream_has_its_channels_units_type_and_rate() -> None:
    settings = line_settings(
        name="chest_strap",
        columns=["n", "t [ms]", "acc/x [m/s^2]", "acc/y [m/s^2]", "-", "force [N]", "temp/t1"],
        sequence_column="n",
        time_column="t",
        rate_hz=50.0,
        irregular=["temp"],
    )
    spec = declared(settings)
    assert spec.name == settings.identity.sensor == "chest_strap"
    acc, data, temp = spec.streams
    assert [(each.label, each.unit) for each in acc.channels] == [("x", "m/s^2"), ("y", "m/s^2")]
    assert (acc.data_name, acc.content_type, acc.rate) == ("acc", ContentType.ACCELEROMETER, 50.0)
    assert acc.message_type is MessageType.FLOAT32_MULTI_ARRAY
    assert (data.data_name, data.content_type, data.labels) == (
        "data",
        ContentType.MISC,
        ("force",),
    )
    assert data.message_type is MessageType.FLOAT32
    assert (temp.rate, temp.channels[0].unit) == (0.0, "none")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x", ("data", "x", "")),
        ("acc/x [m/s^2]", ("acc", "x", "m/s^2")),
        ("  skin conductance [uS] ", ("data", "skin conductance", "uS")),
        ("a/b", ("a", "b", "")),
    ],
)
def test_a_column_is_stream_label_and_unit(text: str, expected: tuple[str, str, str]) -> None:
    assert column(text) == expected


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ('columns = ["x"]\nport = "COM3"', "set one of port, udp_port and url"),
        ('columns = ["x", "x"]', "labels are empty or repeated"),
        ('columns = ["a/b/c"]', "should be LABEL [UNIT] or STREAM/LABEL [UNIT]"),
        ("columns = []", "columns has no channel"),
        ('columns = ["Acc/x"]', "not a lower-case ROS name"),
        ('columns = ["x"]\nsequence_column = "n"', "sequence_column is 'n'"),
        ('columns = ["t [us]", "x"]\nopenearable_sensor = "A"', "the OpenEarable app needs url"),
        ('columns = ["x"]\nopenearable_wearable = "A"', "also set openearable_sensor"),
        ('columns = ["t", "x"]\ntime_column = "t"', "the time has none of the units ns, us, ms, s"),
        ('columns = ["n"]\nsequence_column = "n"', "no channel other than"),
        ('columns = ["x"]\nname = "zephyr"', "not another sensor's name"),
        ('columns = ["x"]\nname = "Arm"', "lower-case letters"),
        ('columns = ["x"]\nirregular = ["y"]', "irregular has y, but the streams are data"),
        ('columns = ["x"]\nformat = "struct"\nstruct_format = "<z"', "is not a format"),
        ('columns = ["x"]\nformat = "struct"\nstruct_format = "<hh"', "has 2 values"),
        ('columns = ["x"]\nframe_start = "5"', "should be hex digits"),
    ],
)
def test_what_cannot_be_is_said_in_one_sentence_with_its_line(lines: str, words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        settings_of(Path("s.toml"), f'{HEAD}unit = "1"\n{lines}\n', settings_models())
    (sentence,) = str(caught.value).splitlines()
    assert sentence.startswith("s.toml, line ")
    assert words in sentence


def table(**fields: str) -> str:
    lines = [f'{key} = "{value}"' for key, value in fields.items()]
    return "\n".join(['[[device]]\nsensor = "line_sensor"\ncolumns = ["x"]', *lines])


@pytest.mark.parametrize(
    ("second", "is_taken"),
    [
        ({"unit": "1", "name": "arm"}, True),
        ({"unit": "1", "name": "leg"}, False),
        ({"unit": "2", "name": "arm", "participant": "p01"}, True),
        ({"unit": "2", "name": "leg", "participant": "p01"}, False),
    ],
)
def test_two_devices_of_one_name_must_differ(second: dict[str, str], *, is_taken: bool) -> None:
    first = table(unit="1", name="arm", participant="p01", port="COM1")
    text = f"{first}\n{table(**second, port='COM2')}\n"
    if is_taken:
        with pytest.raises(ConfigError, match="a second arm with"):
            settings_of(Path("s.toml"), text, settings_models())
    else:
        assert len(settings_of(Path("s.toml"), text, settings_models()).devices) == 2


def test_ways_that_a_format_does_not_have() -> None:
    cases: list[dict[str, Any]] = [
        {"url": "ws://h:1", "format": "struct", "struct_format": "<hh"},
        {"port": "COM1", "format": "struct", "struct_format": "<hh"},
        {"start_command": "go"},
        {"url": "http://h:1"},
        {"url": "ws://h"},
    ]
    for fields in cases:
        with pytest.raises(ValueError, match=r"WebSocket|frame_start|start_command|ws://HOST"):
            line_settings(**fields)


def test_the_values_of_the_openearable_app_begin_with_the_time() -> None:
    asked = {"url": "ws://127.0.0.1:8765/ws", "format": "json", "openearable_sensor": "A"}
    with pytest.raises(ValueError, match="start with the time"):
        line_settings(columns=["x", "t [us]"], time_column="t", **asked)
    line_settings(columns=["t [us]", "x"], time_column="t", **asked)


# Counts and times that turn over, begin again, overtake each other and are lost.
FIELDS: dict[str, Any] = {
    "columns": ["n", "t [ms]", "acc/x", "acc/y", "acc/z", "gsr/gsr"],
    "sequence_column": "n",
    "time_column": "t",
    "rate_hz": 100.0,
    "port": "COM1",
}


def emitted(
    rows: list[tuple[float, ...]], arrivals: list[float] | None = None, **fields: Any
) -> EmitterSink:
    sink = EmitterSink("line_sensor")
    emitter = LineEmitter(line_settings(**FIELDS | fields), sink)
    for number, row in enumerate(rows):
        arrival = 1000.0 + number / 100 if arrivals is None else arrivals[number]
        emitter.take([row], arrival)
    return sink


def row(number: float, ms: float, gsr: float = 1.0) -> tuple[float, ...]:
    return (number, ms, number, 0.0, 0.0, gsr)


@given(
    st.lists(st.integers(1, 100), min_size=1, max_size=50),
    st.integers(0, 255),
)
def test_a_count_that_turns_over_grows(steps: list[int], begin: int) -> None:
    follower = Unwrapped(256, 0)
    follower.place(begin, 0)
    total = 0
    for step in steps:
        total += step
        place = follower.place((begin + total) % 256, 200)
        assert (place.order, place.value, place.step) == (Order.NEXT, total, step)


@given(st.permutations(range(20)), st.integers(0, 255))
def test_each_datagram_is_taken_once(order: list[int], begin: int) -> None:
    follower = Unwrapped(256, 32)
    taken = [
        number
        for number in [*order, *order]
        if follower.place((begin + number) % 256, 1000).order is Order.NEXT
    ]
    assert taken == sorted(set(taken))
    assert taken[-1] == 19


def test_lines_that_are_missing_are_lost_in_every_stream() -> None:
    sink = emitted([row(1, 10), row(2, 20), row(6, 60)])
    assert sink.losses == {"acc": 3, "gsr": 3}
    assert sink.device_times["acc"] == pytest.approx([0.0, 0.01, 0.05])


def test_the_turn_of_a_clock_is_no_restart() -> None:
    last = 2**32 - 5
    sink = emitted([row(1, last), row(2, 5), row(3, 15)])
    assert sink.device_times["gsr"] == pytest.approx([0.0, 0.01, 0.02])
    assert sink.restarts == []


@pytest.mark.parametrize("uptime", [3, 400, 500_000_000])
def test_a_restart_loses_nothing_and_begins_a_new_clock(uptime: int) -> None:
    rows = [row(uptime + each, 10.0 * (uptime + each)) for each in range(3)]
    again = [row(each, 10.0 * each) for each in range(3)]
    sink = emitted([*rows, *again])
    assert len(sink.restarts) == 1
    assert sink.losses == {}
    assert len(sink.emitted["acc"]) == 6


def test_a_device_that_was_off_and_counts_further_than_before_is_noticed() -> None:
    sink = EmitterSink("line_sensor")
    emitter = LineEmitter(line_settings(**FIELDS), sink)
    emitter.connected()
    emitter.take([row(50, 500)], 1000.0)
    emitter.connected()
    emitter.take([row(60, 600)], 1010.0)
    assert (sink.restarts, sink.losses) == ([1], {})


def test_a_device_that_kept_its_lines_goes_on() -> None:
    sink = EmitterSink("line_sensor")
    emitter = LineEmitter(line_settings(**FIELDS), sink)
    emitter.take([row(50, 500)], 1000.0)
    emitter.connected()
    emitter.take([row(51, 510), row(52, 520)], 1010.0)
    assert (sink.restarts, sink.losses) == ([], {})


def test_a_count_that_leaps_is_no_loss_of_millions() -> None:
    sink = emitted([row(1, 10), row(4_000_000, 20), row(4_000_001, 30)])
    assert sink.losses == {}
    assert sink.device_times["acc"] == pytest.approx([0.0, 0.01, 0.02])


def test_what_was_overtaken_is_left_out() -> None:
    rows = [row(1, 10), row(3, 30), row(2, 20), row(3, 30), row(4, 40)]
    sink = emitted(rows, port=None, udp_port=5005)
    assert [each[0] for each in sink.emitted["acc"]] == [1, 3, 4]
    assert sink.losses == {"acc": 1, "gsr": 1}


def test_without_a_time_the_count_is_the_clock() -> None:
    rows = [(1, 0, 0, 0, 1.0), (2, 0, 0, 0, 1.0), (5, 0, 0, 0, 1.0)]
    columns = ["n", "acc/x", "acc/y", "acc/z", "gsr/gsr"]
    sink = emitted(rows, columns=columns, time_column="")
    assert sink.device_times["acc"] == pytest.approx([0.0, 0.01, 0.04])


def test_without_either_what_came_together_ends_with_its_arrival() -> None:
    fields = {"columns": ["acc/x", "acc/y", "acc/z", "gsr/gsr"]}
    settings = line_settings(**FIELDS | fields | {"sequence_column": "", "time_column": ""})
    sink = EmitterSink("line_sensor")
    LineEmitter(settings, sink).take([(1, 2, 3, 4)] * 3, 1000.0)
    assert sink.lsl_times["acc"] == pytest.approx([999.98, 999.99, 1000.0])
    assert sink.observed == []


def test_a_stream_without_a_value_in_most_lines_has_only_those() -> None:
    rows = [row(1, 10, nan), row(2, 20, 7.0), row(3, 30, nan)]
    sink = emitted(rows, irregular=["gsr"])
    assert sink.values("gsr") == [7.0]
    assert sink.device_times["gsr"] == pytest.approx([0.01])
    assert len(sink.emitted["acc"]) == 3


@pytest.mark.parametrize("drift_ppm", [-200.0, 0.0, 150.0])
def test_stamps_are_those_of_measuring_whatever_the_way_does(drift_ppm: float) -> None:
    rng = np.random.default_rng(7)
    true_s = 5000.0 + np.arange(6000) / 100
    ticks = np.round((true_s - 4000.0) * (1 + drift_ppm * 1e-6) * 1e6)
    arrivals = np.maximum.accumulate(true_s + rng.uniform(0, 0.1, len(true_s)))
    rows = [row(number, float(tick)) for number, tick in enumerate(ticks)]
    columns = ["n", "t [us]", *FIELDS["columns"][2:]]
    sink = EmitterSink("line_sensor")
    emitter = LineEmitter(line_settings(**FIELDS | {"columns": columns}), sink)
    stamps: list[float] = []
    for each, arrival in zip(rows, arrivals, strict=True):
        emitter.take([each], float(arrival))
        stamps.append(sink.mapped(sink.device_times["acc"][-1]))
    errors = (np.array(stamps) - true_s)[true_s > true_s[0] + 10]
    assert np.abs(errors).max() < 0.020
    assert np.sqrt(np.mean(np.diff(errors) ** 2)) < 0.001


@pytest.mark.parametrize("stray", [row(0, 0.0), row(900_000, 5.0), row(7000, 1e9), row(5, 1990.0)])
@pytest.mark.parametrize("way", [{}, {"port": None, "udp_port": 5005}])
def test_a_stray_line_is_left_out_and_loses_nothing(
    stray: tuple[float, ...], way: dict[str, Any]
) -> None:
    good = [row(number, 10.0 * number) for number in range(1, 2000)]
    rows = [*good[:500], stray, stray, *good[500:900], stray, *good[900:901], stray, *good[901:]]
    arrivals = [1000.0 + each[0] / 100 for each in good]
    for at in (500, 501, 902, 904):
        arrivals.insert(at, arrivals[at - 1])
    sink = emitted(rows, arrivals, **way)
    assert [each[0] for each in sink.emitted["acc"]] == [each[0] for each in good]
    assert (sink.restarts, sink.losses) == ([], {})
    # Its own clock begins with its first line.
    measured = [(each[1] - good[0][1]) / 1000 for each in good]
    assert sink.device_times["acc"] == pytest.approx(measured)


def test_a_line_that_nothing_came_after_is_not_kept_back_for_ever() -> None:
    sink = EmitterSink("line_sensor")
    emitter = LineEmitter(line_settings(**FIELDS), sink)
    for each in (row(50, 500), row(51, 510), row(1, 10)):
        emitter.take([each], 1000.0)
    assert len(sink.emitted["acc"]) == 2
    emitter.ended()
    assert len(sink.emitted["acc"]) == 3
    assert len(sink.restarts) == 1
