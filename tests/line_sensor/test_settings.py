"""What settings of line sensors declare, and what is said of those that cannot be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from biosensor_common.errors import ConfigError
from biosensor_common.quantities import ContentType, MessageType
from biosensor_gateway.devices.line_sensor import column
from biosensor_gateway.devices.registry import declared, settings_models
from biosensor_gateway.settings.file import settings_of
from tests.line_sensor.conftest import line_settings

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
        ('columns = ["x"]\nopenearable_wearable = "A"', "set openearable_sensor, too"),
        ('columns = ["t", "x"]\ntime_column = "t"', "the time has none of the units ns, us, ms, s"),
        ('columns = ["n"]\nsequence_column = "n"', "no channel besides"),
        ('columns = ["x"]\nname = "zephyr"', "no other sensor's name"),
        ('columns = ["x"]\nname = "Arm"', "lower-case letters"),
        ('columns = ["x"]\nirregular = ["y"]', "irregular has y, and the streams are data"),
        ('columns = ["x"]\nformat = "struct"\nstruct_format = "<z"', "is no format"),
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
    with pytest.raises(ValueError, match="begin with the time"):
        line_settings(columns=["x", "t [us]"], time_column="t", **asked)
    line_settings(columns=["t [us]", "x"], time_column="t", **asked)
