"""Tables of sensors and topics in Markdown, made from the declarations."""

from __future__ import annotations

from collections.abc import Iterator

from biosensor_common.quantities import ContentType
from biosensor_common.spec import FromDevice, SensorSpec, StreamSpec
from biosensor_gateway.devices.registry import (
    declaration,
    declaration_names,
    driver,
    sensor_names,
)

CONTRACT, OURS = "●", "○"
# More channels than this are shown by the first and the last.
_SHOWN_CHANNELS = 10
# What tells of the device and not of its wearer; the short table leaves it out.
_HOUSEKEEPING = frozenset(
    {ContentType.BATTERY, ContentType.QUALITY, ContentType.RSSI, ContentType.STATUS}
)

_COLUMNS = (
    "",
    "Topic",
    "Message",
    "Channels [unit]",
    "Rate, Hz",
    "Chunk topic",
    "LSL type, format",
)


def sensors() -> str:
    """Return a row for each sensor: its page and its signals."""
    specs = [spec for spec in _in_order() if _rank(spec) == 0]
    rows = [
        (f"[{spec.title}](docs/sensors/{spec.name}.md)", f"`{spec.name}`", _signals(spec))
        for spec in specs
    ]
    return f"\n{table(('Sensor', 'Name', 'Signals, as LSL types'), rows)}\n\n"


def topics() -> str:
    """Return all topics: a table for each sensor with a driver first, the agent's own last."""
    return "".join(f"\n{_section(spec)}\n" for spec in _in_order()) + "\n"


def table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a table in Markdown."""
    ruler = "|".join("---" for _ in columns)
    return "\n".join([_line(columns), f"|{ruler}|", *map(_line, rows)])


def _line(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"


def _in_order() -> list[SensorSpec]:
    return sorted((declaration(name) for name in declaration_names()), key=_rank)


def _rank(spec: SensorSpec) -> int:
    return 2 if spec.name == "gateway" else int(spec.name not in sensor_names())


def _is_an_example(spec: SensorSpec) -> bool:
    """Whether the settings of each device declare what it has, and this is one of them."""
    return _rank(spec) == 0 and driver(spec.name).declare is not None


def _signals(spec: SensorSpec) -> str:
    if _is_an_example(spec):
        return "what its settings declare"
    signals = [stream for stream in spec.streams if stream.content_type not in _HOUSEKEEPING]
    # Continuous ones first: who looks for a sensor looks for these.
    signals.sort(key=lambda stream: not stream.is_regular)
    # A headset has two streams of one type.
    return ", ".join(dict.fromkeys(_signal(stream) for stream in signals))


def _signal(stream: StreamSpec) -> str:
    rate = f" {_rate(stream)} Hz" if stream.is_regular and not stream.is_from_device else ""
    return f"{stream.content_type}{rate}"


def _section(spec: SensorSpec) -> str:
    source = ("driver", "no driver", "the agent itself")[_rank(spec)]
    if _is_an_example(spec):
        source += "; its settings declare the streams, here those of the example"
    rows = [_cells(spec, stream) for stream in spec.streams]
    return f"## {spec.title}\n\n`{spec.name}` ({source})\n\n{table(_COLUMNS, rows)}"


def _cells(spec: SensorSpec, stream: StreamSpec) -> tuple[str, ...]:
    return (
        CONTRACT if stream.contract else OURS,
        f"`{spec.name}/{stream.data_name}`",
        stream.message_type.rpartition("/")[2],
        _channels(stream),
        _rate(stream),
        f"`…/{stream.chunk}_chunk`" if stream.chunk else "",
        f"{stream.content_type}, {stream.format}",
    )


def _rate(stream: StreamSpec) -> str:
    if isinstance(stream.rate, FromDevice):
        return "set by the device"
    return f"{stream.rate:.5g}" if stream.is_regular else "irregular"


def _channels(stream: StreamSpec) -> str:
    groups: list[str] = []
    for unit, labels in _by_unit(stream):
        if len(labels) > _SHOWN_CHANNELS:
            shown = f"{labels[0]} … {labels[-1]} ({len(labels)})"
        else:
            shown = ", ".join(labels)
        groups.append(shown if unit == "none" else f"{shown} [{unit}]")
    return "; ".join(groups)


def _by_unit(stream: StreamSpec) -> Iterator[tuple[str, list[str]]]:
    """Yield neighbouring channels of one unit together, in channel order."""
    labels: list[str] = []
    for index, channel in enumerate(stream.channels):
        labels.append(channel.label)
        following = stream.channels[index + 1 :]
        if not following or following[0].unit != channel.unit:
            yield channel.unit, labels
            labels = []
