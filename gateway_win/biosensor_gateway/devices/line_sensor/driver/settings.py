"""Settings of a line sensor: the source and the contents of its lines."""

from __future__ import annotations

from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, model_validator

from biosensor_common.errors import SpecError
from biosensor_common.naming import AGENT, NODE
from biosensor_common.spec import SensorSpec, is_data_name
from biosensor_gateway.devices import registry
from biosensor_gateway.devices.line_sensor import (
    EXAMPLE_COLUMNS,
    NAME,
    Column,
    column,
    line_sensor_spec,
)
from biosensor_gateway.devices.line_sensor.driver.protocol import (
    checked_format,
    field_count,
)
from biosensor_gateway.settings.models import DeviceSettings, ShortText

MAX_COLUMNS = 256
TICKS_S = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
"""Length of a device's tick in seconds by the unit of its time column."""


def _name(value: str) -> str:
    taken = {AGENT, NODE, *registry.sensor_names()} - {NAME}
    if value and (not is_data_name(value) or value in taken):
        raise ValueError(
            "should be lower-case letters, digits and single _ , such as chest_strap, and not "
            "another sensor's name"
        )
    return value


def _column(value: str) -> str:
    column(value)
    return value


def _url(value: str | None) -> str | None:
    if value is None:
        return None
    try:
        parts = urlsplit(value)
        is_whole = parts.scheme in ("ws", "wss") and bool(parts.hostname and parts.port)
    except ValueError:
        is_whole = False
    if not is_whole:
        raise ValueError("should be ws://HOST:NUMBER or wss://HOST:NUMBER, with a path if needed")
    return value


def _hex(value: str) -> str:
    try:
        bytes.fromhex(value)
    except ValueError:
        raise ValueError("should be hex digits, two for each byte, such as aa55") from None
    return value


class LineSettings(DeviceSettings):
    """Settings of one line sensor."""

    name: Annotated[ShortText, AfterValidator(_name)] = Field(
        default="",
        description="The device's name in topics: with chest_strap they are "
        "/biosensors/chest_strap/... If empty, line_sensor.",
    )
    port: str | None = Field(
        default=None,
        min_length=1,
        description="The lines come from one of three sources. First: a serial port, such as COM5 "
        "or /dev/ttyACM0, or socket://HOST:NUMBER for TCP.",
        examples=["/dev/ttyACM0"],
    )
    baud_rate: int = Field(
        default=115200, ge=1, le=20_000_000, description="Baud rate of the serial port."
    )
    udp_port: int | None = Field(
        default=None,
        ge=1,
        le=65535,
        description="Second: the UDP port of this computer to which the device sends. Each device "
        "has its own.",
    )
    url: Annotated[str | None, AfterValidator(_url)] = Field(
        default=None, description="Third: the device's WebSocket, such as ws://192.168.1.20:81/."
    )
    format: Literal["csv", "json", "struct"] = Field(
        default="csv",
        description="What the device sends: csv (lines of values between separators), json (an "
        "object or array in each line) or struct (bytes).",
    )
    separator: Literal["comma", "semicolon", "tab", "space"] = Field(
        default="comma", description="Separator between csv values."
    )
    columns: tuple[Annotated[str, AfterValidator(_column)], ...] = Field(
        strict=False,
        max_length=MAX_COLUMNS,
        description="What each value of a line is, in their order: STREAM/LABEL [UNIT]. Without "
        "STREAM/ it is a channel of the stream data; - is a value that is not needed.",
        examples=[list(EXAMPLE_COLUMNS)],
    )
    sequence_column: str = Field(
        default="",
        description="Label of the column that counts the lines, if there is one: it shows losses.",
    )
    sequence_turns_over_at: int = Field(
        default=0,
        ge=0,
        description="Where the count wraps around, such as 256 for one byte. 0: at 2^32, or in a "
        "struct at the limit of its bytes.",
    )
    time_column: str = Field(
        default="",
        description="Label of the column with the device's time, if there is one; its unit is "
        "[us], [ms], [s] or [ns].",
    )
    time_turns_over_at: int = Field(
        default=0,
        ge=0,
        description="Where the time wraps around. 0: at 2^32, as micros() and millis() of Arduino "
        "do, and never in [s] and [ns].",
    )
    rate_hz: float = Field(
        default=0.0,
        ge=0,
        le=100_000,
        allow_inf_nan=False,
        description="Lines per second; 0 if they come irregularly.",
    )
    irregular: tuple[str, ...] = Field(
        default=(),
        strict=False,
        description="Streams without a value in most lines: an empty one in csv, none in json.",
    )
    struct_format: str = Field(
        default="",
        description="Format of a struct record, in the letters of Python's struct: such as "
        "<IIhhhH.",
    )
    frame_start: Annotated[str, AfterValidator(_hex)] = Field(
        default="",
        max_length=32,
        description="Bytes with which each struct record starts, in hex digits, such as aa55.",
    )
    checksum: Literal["none", "sum", "xor", "crc16"] = Field(
        default="none", description="What follows the values of a struct record."
    )
    start_command: str = Field(
        default="",
        max_length=200,
        description="Text to send once the device is connected, if it waits for one.",
    )

    openearable_sensor: ShortText = Field(
        default="",
        description="Name of a sensor, such as Accelerometer, to request from the OpenEarable app "
        "at url: the first column of its values is the time. Empty for anything else.",
    )
    openearable_wearable: ShortText = Field(
        default="",
        description="Name or id of the wearable in that app; if empty, the only one connected to "
        "it.",
    )

    @property
    def sensor_name(self) -> str:
        """The device's name in streams and topics."""
        return self.name or NAME

    @property
    def parsed_columns(self) -> list[Column]:
        """Columns of a line."""
        return [column(each) for each in self.columns]

    @property
    def apart(self) -> tuple[str, ...]:
        """Labels of the count and time columns."""
        return tuple(each for each in (self.sequence_column, self.time_column) if each)

    @property
    def spec(self) -> SensorSpec:
        """Declaration of the device."""
        return line_sensor_spec(
            self.sensor_name, self.parsed_columns, self.apart, self.rate_hz, self.irregular
        )

    def position(self, label: str) -> int | None:
        """Return the position of a label's column in a line; None for an empty label."""
        labels = [each.label for each in self.parsed_columns]
        return labels.index(label) if label else None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        for broken, rule in (*self._wrong_way(), *self._wrong_columns(), *self._wrong_struct()):
            if broken:
                raise ValueError(rule)
        try:
            declared = self.spec.streams
        except SpecError as error:
            raise ValueError(str(error)) from error
        names = [each.data_name for each in declared]
        unknown = [each for each in self.irregular if each not in names]
        if unknown:
            raise ValueError(f"irregular has {unknown[0]}, but the streams are {', '.join(names)}")
        if not names:
            raise ValueError("columns has no channel other than the count and the time")
        return self

    def _wrong_way(self) -> list[tuple[bool, str]]:
        ways = [each for each in (self.port, self.udp_port, self.url) if each is not None]
        return [
            (len(ways) != 1, "set one of port, udp_port and url: where the lines come from"),
            (
                self.url is not None and self.format == "struct",
                'only text is supported over a WebSocket: choose format = "csv" or "json", or UDP',
            ),
            (
                self.udp_port is not None and bool(self.start_command),
                "start_command cannot be sent by UDP: its port only listens",
            ),
            *self._wrong_openearable(),
        ]

    def _wrong_openearable(self) -> list[tuple[bool, str]]:
        first = self.parsed_columns[0].label if self.columns else ""
        is_asked = bool(self.openearable_sensor)
        return [
            (
                is_asked and (self.url is None or self.format != "json"),
                'the OpenEarable app needs url, such as ws://192.168.1.20:8765/ws, and "json"',
            ),
            (
                is_asked and (not first or first != self.time_column),
                (
                    'the values of the OpenEarable app start with the time: "t [us]" as the '
                    'first column, and time_column = "t"'
                ),
            ),
            (
                bool(self.openearable_wearable) and not is_asked,
                "openearable_wearable is for the app: also set openearable_sensor",
            ),
        ]

    def _wrong_columns(self) -> list[tuple[bool, str]]:
        columns = self.parsed_columns
        labels = [each.label for each in columns]
        unit = next((each.unit for each in columns if each.label == self.time_column), "")
        return [
            *(
                (
                    labels.count(label) != 1,
                    f"{key} is {label!r}, but columns does not have it exactly once",
                )
                for key, label in (
                    ("sequence_column", self.sequence_column),
                    ("time_column", self.time_column),
                )
                if label
            ),
            (
                bool(self.time_column) and unit not in TICKS_S,
                f'the time has none of the units {", ".join(TICKS_S)}: "{self.time_column} [ms]"',
            ),
            (
                bool(self.sequence_column) and self.sequence_column == self.time_column,
                "sequence_column and time_column are the same column",
            ),
        ]

    def _wrong_struct(self) -> list[tuple[bool, str]]:
        if self.format != "struct":
            return []
        try:
            fields = field_count(checked_format(self.struct_format))
        except ValueError as error:
            return [(True, f"struct_format: {error}")]
        return [
            (
                fields != len(self.columns),
                f"struct_format has {fields} values, but columns names {len(self.columns)}",
            ),
            (
                self.udp_port is None and not self.frame_start,
                "frame_start is empty: in a stream of bytes nothing shows where a record starts",
            ),
        ]
