"""Writes README.txt: the contents of an export, for readers who do not program."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.exporter import Clock, ExportOptions, Times, timeline

README = "README.txt"
_LONG = """\
One table for all streams: a row for each value of each channel, one stream after the other.
Columns: its time, who wore the sensor, the stream, the channel, its unit, and the value.

value is a number; it is empty where the next column, text, has a text. NaN means that there is
no value. Where samples are missing, so are their rows.

The file is UTF-8, columns are separated by commas, decimals have a point. In a spreadsheet
whose decimals are commas, import it as text with a point (in Excel: Data > From Text/CSV).
"""
OF_ONE_FILE = {"csv-long": _LONG, "csv-long.gz": _LONG}
"""What formats mean that are one file, so that README.txt stands beside it."""
_WIDTH = 100
_MOST_CHANNELS, _MOST_FILES = 12, 4
_CLOCKS = {
    Clock.LSL: "on the LSL clock of the recording computer, which started when the computer was "
    "switched on",
    Clock.WALL: "unix time: seconds since the start of 1970, in UTC",
}
_ZERO = """\
Seconds count from there: it is the first sample of all streams with a rate and of all streams of
other programs, as in biosensor-gateway xdf check. What was measured before, such as the state of a
battery, a heart rate over seconds that had passed, or a marker, can have negative seconds.
"""
_TIMES = {
    Times.RECORDED: "Times are as recorded. Nothing was filled in where samples are missing.",
    Times.EVEN: (
        "Samples of a stream with a rate were put on a straight line between two gaps (--times "
        "even). Nothing was filled in; each gap is an event called BAD_gap."
    ),
}


def readme_beside(target: Path) -> Path:
    """Return the path of the README that describes an export of one file."""
    return target.with_name(f"{target.name}.{README}")


def write_readme(
    place: Path,
    chosen: Chosen,
    options: ExportOptions,
    means: str,
    files: Mapping[int, Sequence[str]],
    notes: Sequence[str],
) -> None:
    """Write it into an otherwise complete export.

    Parameters
    ----------
    place
        Folder of the export; of one file the file to write.
    means
        Paragraphs about the files and how to read them.
    files
        File names or topics of each exported stream, by stream number.
    notes
        Notes on this export, besides those of `options`.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    program = version("biosensor-gateway")
    blocks = [
        [f"{chosen.contents.path.name}, exported by biosensor-gateway {program}."],
        ["WHAT IS HERE", *_items(_described(chosen, files))],
        ["HOW TO READ IT", *_items(means.split("\n\n"))],
        ["TIMES", *_items(_times(chosen, options))],
    ]
    if known := [*options.notes, *notes]:
        blocks.append(["WHAT YOU SHOULD KNOW", *_items(known)])
    text = "\n\n".join("\n".join(each) for each in blocks) + "\n"
    # Names in headers may contain unpaired surrogates.
    path = place / README if place.is_dir() else place
    with path.open("x", encoding="utf-8", errors="replace", newline="\n") as file:
        file.write(text)


def _items(texts: Sequence[str] | Iterator[str]) -> Iterator[str]:
    for each in texts:
        plain = " ".join("".join(c if c.isprintable() else " " for c in each).split())
        yield textwrap.fill(plain, _WIDTH, initial_indent="- ", subsequent_indent="  ")


def _described(chosen: Chosen, files: Mapping[int, Sequence[str]]) -> Iterator[str]:
    for stream in chosen.streams:
        if names := files.get(stream.number):
            more = f" and {len(names) - _MOST_FILES} more" if len(names) > _MOST_FILES else ""
            yield f"{', '.join(names[:_MOST_FILES])}{more}: {_stream_text(stream)}"


def _stream_text(stream: Stream) -> str:
    """Describe a stream: what was measured, participant, rate and units."""
    header, identity = stream.header, stream.header.identity
    whose = f" of {identity.participant}" if identity and identity.participant else ""
    sensor = f", measured by {identity.sensor} {identity.unit}" if identity else ""
    rate = f"{header.rate:g} times a second" if header.is_regular else "whenever it happened"
    told = f"{header.content_type or header.name}{whose}{sensor}, {rate}"
    if header.format is ChannelFormat.STRING:
        return f"{told}; texts"
    channels = [
        f"{label} in {unit}" if unit and unit != "none" else label
        for label, unit in zip(header.labels, stream.meaning.units, strict=True)
    ]
    more = f" and {len(channels) - _MOST_CHANNELS} more" if len(channels) > _MOST_CHANNELS else ""
    return f"{told}; {', '.join(channels[:_MOST_CHANNELS])}{more}"


def _times(chosen: Chosen, options: ExportOptions) -> Iterator[str]:
    line = timeline(chosen, options.clock)
    clock = _CLOCKS[options.clock]
    yield f"All times are in seconds. Unless stated otherwise, they are {clock}."
    date = line.described()["TimeZero"]
    which = f", which is {date['Date']}" if isinstance(date, dict) and "Date" in date else ""
    # A selection may begin later.
    what = "This selection" if chosen.begin_s > chosen.contents.begin_s else "The recording"
    yield f"{what} starts at {line.begin_s:.6f}{which}. {_ZERO}"
    yield _TIMES[options.times]
