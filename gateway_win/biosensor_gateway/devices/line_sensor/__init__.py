"""Declares a line sensor's streams, which depend on each device's settings.

`SPEC` is the declaration for the example settings, shown in lists and documents.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from biosensor_common.quantities import ContentType, Unit
from biosensor_common.spec import IRREGULAR, ChannelSpec, SensorSpec, StreamSpec
from biosensor_common.table import raw
from biosensor_gateway.devices.sensor import Sensor

NAME = "line_sensor"
EXAMPLE_COLUMNS = ("n", "t [us]", "acc/x [g]", "acc/y [g]", "acc/z [g]", "gsr/gsr [microsiemens]")
EXAMPLE_COUNTS, EXAMPLE_TELLS_TIME = "n", "t"
EXAMPLE_RATE_HZ = 100.0

USUAL_STREAM = "data"
SKIPPED = "-"

_COLUMN = re.compile(
    r"(?:(?P<stream>[^/\[\]]*)/)?(?P<label>[^/\[\]]+?)[ ]*(?:\[(?P<unit>[^\[\]]+)\])?"
)

# LSL content type by data name; `ContentType.MISC` for all others.
_CONTENT: Mapping[str, ContentType] = MappingProxyType(
    {
        "acc": ContentType.ACCELEROMETER,
        "bvp": ContentType.PPG,
        "ecg": ContentType.ECG,
        "eda": ContentType.GSR,
        "eeg": ContentType.EEG,
        "gsr": ContentType.GSR,
        "hr": ContentType.HR,
        "ppg": ContentType.PPG,
        "resp": ContentType.RESPIRATION,
        "rr": ContentType.RR,
        "temp": ContentType.TEMPERATURE,
    }
)


_UNITS: Mapping[str, Unit] = MappingProxyType({each.value: each for each in Unit})


_NO_BOUNDS = "only its user knows what a self-built device measures"


class Column(NamedTuple):
    """One column of each line."""

    stream: str  # Data name of its stream.
    label: str  # Label of the channel; `SKIPPED` for an unused column.
    unit: str  # Empty if the settings contain none.

    @property
    def is_skipped(self) -> bool:
        """Whether its values are ignored."""
        return self.label == SKIPPED


def column(text: str) -> Column:
    """Parse ``stream/label [unit]``; stream and unit may be missing.

    Raises
    ------
    ValueError
        If it does not have that form.
    """
    found = _COLUMN.fullmatch(text.strip())
    if found is None:
        raise ValueError("should be LABEL [UNIT] or STREAM/LABEL [UNIT]")
    stream = found["stream"]
    return Column(
        USUAL_STREAM if stream is None else stream.strip(), found["label"], found["unit"] or ""
    )


def streams_of(columns: Iterable[Column], apart: Iterable[str]) -> dict[str, list[int]]:
    """Return the positions of each stream's channels, by data name and in order.

    Parameters
    ----------
    apart
        Labels of the count and time columns.
    """
    without = {SKIPPED, *apart}
    streams: dict[str, list[int]] = {}
    for position, each in enumerate(columns):
        if each.label not in without:
            streams.setdefault(each.stream, []).append(position)
    return streams


def unit_of(each: Column) -> str:
    """Return the unit of a channel, as a standard unit if possible."""
    unit = each.unit or Unit.NONE
    return _UNITS.get(unit, unit)


def line_sensor_spec(
    name: str,
    columns: Sequence[Column],
    apart: Iterable[str],
    rate_hz: float,
    irregular: Collection[str] = (),
) -> SensorSpec:
    """Return the declaration of a device.

    Parameters
    ----------
    name
        Its name in topics.
    apart
        Labels of the count and time columns, which are not channels.
    rate_hz
        Lines per second; 0 if irregular.
    irregular
        Data names of streams that do not have a value in every line.

    Raises
    ------
    SpecError
        ``INVALID``, with the name, stream or channel and the rule that it breaks.
    """
    streams = streams_of(columns, apart)
    return SensorSpec(
        name=name,
        title="Line sensor" if name == NAME else name,
        manufacturer="",
        model="",
        streams=tuple(
            _stream(
                data_name,
                [columns[each] for each in positions],
                IRREGULAR if data_name in irregular else rate_hz,
            )
            for data_name, positions in streams.items()
        ),
    )


def _stream(data_name: str, columns: Sequence[Column], rate_hz: float) -> StreamSpec:
    return raw(
        data_name,
        _CONTENT.get(data_name, ContentType.MISC),
        tuple(ChannelSpec(each.label, unit_of(each), plausible=_NO_BOUNDS) for each in columns),
        rate_hz,
        chunk=data_name if rate_hz else "",
    )


SPEC = line_sensor_spec(
    NAME,
    [column(each) for each in EXAMPLE_COLUMNS],
    (EXAMPLE_COUNTS, EXAMPLE_TELLS_TIME),
    EXAMPLE_RATE_HZ,
)

_SIMULATOR = "biosensor_gateway.devices.line_sensor.simulator"

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.line_sensor.driver:DRIVER",
    virtual={
        "": f"{_SIMULATOR}:SimulatedLineSensor",
        "udp": f"{_SIMULATOR}:UdpLineSensor",
    },
    precedence=-1,
)
