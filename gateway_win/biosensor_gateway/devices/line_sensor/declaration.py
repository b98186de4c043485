"""What a line sensor emits: for each device what its settings say.

`SPEC` is the declaration of one whose settings are the example, which lists and documents show.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType

from biosensor_common.quantities import ContentType
from biosensor_common.spec import IRREGULAR, ChannelSpec, SensorSpec, StreamSpec
from biosensor_common.table import raw
from biosensor_gateway.devices.line_sensor.columns import Column, column, streams_of, unit_of

NAME = "line_sensor"
EXAMPLE_COLUMNS = ("n", "t [us]", "acc/x [g]", "acc/y [g]", "acc/z [g]", "gsr/gsr [microsiemens]")
EXAMPLE_COUNTS, EXAMPLE_TELLS_TIME = "n", "t"
EXAMPLE_RATE_HZ = 100.0

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
"""LSL's content type by data name; what is not here is `ContentType.MISC`."""


def line_sensor_spec(
    name: str,
    columns: Sequence[Column],
    apart: Iterable[str],
    rate_hz: float,
    irregular: Collection[str] = (),
) -> SensorSpec:
    """Declare what a device emits.

    Parameters
    ----------
    name
        What its topics call it.
    columns
        Of its lines.
    apart
        Labels of the columns that count or tell the time, which are no channels.
    rate_hz
        Lines a second; 0 where they come when they come.
    irregular
        Data names of streams without a value in every line.

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
        tuple(ChannelSpec(each.label, unit_of(each)) for each in columns),
        rate_hz,
        chunk=data_name if rate_hz else "",
    )


SPEC = line_sensor_spec(
    NAME,
    [column(each) for each in EXAMPLE_COLUMNS],
    (EXAMPLE_COUNTS, EXAMPLE_TELLS_TIME),
    EXAMPLE_RATE_HZ,
)
