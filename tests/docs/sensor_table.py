"""The README's table of sensors and topics, made from the declarations.

``python tests/docs/sensor_table.py README.md`` writes it, ``--check`` only says
whether it is up to date.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from biosensor_common.registry import sensor, sensor_names
from biosensor_common.spec import FromDevice, SensorSpec, StreamSpec
from biosensor_gateway.devices import driver_names

BEGIN, END = "<!-- sensors:begin -->", "<!-- sensors:end -->"
CONTRACT, OURS = "●", "○"
# More channels than this are shown by the first and the last.
_SHOWN_CHANNELS = 10

_COLUMNS = (
    "",
    "Topic",
    "Message",
    "Channels [unit]",
    "Rate, Hz",
    "Chunk topic",
    "LSL type, format",
)
_BETWEEN = re.compile(f"(?<={re.escape(BEGIN)}\n).*?(?={re.escape(END)})", re.DOTALL)


def updated(text: str) -> str:
    """Return a document with the present table between its markers.

    Raises
    ------
    ValueError
        If the document does not have the two markers once, in order.
    """
    if text.count(BEGIN) != 1 or text.count(END) != 1 or not _BETWEEN.search(text):
        raise ValueError(f"the lines {BEGIN} and {END} must be there once each, in this order")
    # A function, because backslashes in a replacement string would be escapes.
    return _BETWEEN.sub(lambda _: table(), text)


def table() -> str:
    """Return all sensors as Markdown: those with a driver first, the agent itself last."""
    sections = sorted((sensor(name) for name in sensor_names()), key=_rank)
    return "".join(f"\n{_section(spec)}\n" for spec in sections) + "\n"


def _rank(spec: SensorSpec) -> int:
    return 2 if spec.name == "gateway" else int(spec.name not in driver_names())


def _section(spec: SensorSpec) -> str:
    source = ("driver", "no driver", "the agent itself")[_rank(spec)]
    ruler = "|".join("---" for _ in _COLUMNS)
    rows = "\n".join(_line(_cells(spec, stream)) for stream in spec.streams)
    return f"**{spec.title}**: `{spec.name}` ({source})\n\n{_line(_COLUMNS)}\n|{ruler}|\n{rows}"


def _cells(spec: SensorSpec, stream: StreamSpec) -> tuple[str, ...]:
    return (
        CONTRACT if stream.contract else OURS,
        f"`{spec.name}/{stream.data_name}`",
        stream.message_type.rpartition("/")[2],
        _channels(stream),
        _rate(stream),
        f"`{spec.name}/{stream.chunk}_chunk`" if stream.chunk else "",
        f"{stream.content_type}, {stream.format}",
    )


def _line(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"


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


def main() -> None:
    """Write the table, or with ``--check`` exit with 1 if it is out of date."""
    parser = argparse.ArgumentParser(description="Update the table of sensors in a document.")
    parser.add_argument("document", type=Path)
    parser.add_argument("--check", action="store_true", help="write nothing")
    options = parser.parse_args()
    before = options.document.read_text(encoding="utf-8")
    after = updated(before)
    if options.check and after != before:
        sys.exit(f"{options.document}: the table of sensors is out of date; run: make docs")
    if not options.check:
        options.document.write_text(after, encoding="utf-8")


if __name__ == "__main__":
    main()
