"""``biosensor-gateway xdf export``: a recording in the formats of others."""

from __future__ import annotations

import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.cli.options import (
    FromOption,
    JsonOption,
    ParticipantOption,
    StreamsOption,
    UntilOption,
    WithoutOption,
)
from biosensor_gateway.cli.recordings import RecordingArgument, wrong_recording
from biosensor_gateway.cli.screen import say
from biosensor_gateway.recording.contents.choice import Wish
from biosensor_gateway.recording.export import exporter, printing
from biosensor_gateway.recording.export.exporting import Task, Watch, export
from biosensor_gateway.recording.export.formats import FORMATS
from biosensor_gateway.recording.participants import Whose


def export_recording(
    file: RecordingArgument,
    to: Annotated[
        list[str],
        typer.Option("--to", metavar="FORMAT", help=f"{', '.join(FORMATS)} (repeatable)."),
    ],
    streams: StreamsOption = None,
    participant: ParticipantOption = "",
    without: WithoutOption = "",
    begin: FromOption = "",
    end: UntilOption = "",
    clock: Annotated[
        exporter.Clock, typer.Option(help="LSL time, or unix time where the recording tells it.")
    ] = exporter.Clock.LSL,
    task: Annotated[
        str, typer.Option(help="For bids; else from the recording's name, or study.")
    ] = "",
    session: Annotated[str, typer.Option(help="For bids; else from the recording's name.")] = "",
    whose: Annotated[
        Whose | None,
        typer.Option(
            help="Who is right where the recording's name says another participant than its "
            "sensors.",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="PLACE",
            help="A folder to write into, or the new file itself, instead of beside the recording.",
            show_default=False,
        ),
    ] = None,
    print_json: JsonOption = False,
) -> None:
    """Write a recording as others load it; exit code 1 if not all of it could be written.

    Exit code 1 also if its name says another participant than its sensors, until --whose says
    who is right.

    Times are as recorded, with the clock offsets applied, and never made
    regular. What can be read of a damaged recording is exported. No file
    is overwritten.
    """
    for each in to:
        if each not in FORMATS:
            message = f"there is no format {each!r}; there is {', '.join(FORMATS)}"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
    wish = Wish(streams or (), begin, end, participant, without)
    with wrong_recording(), _bars() as watch:
        outcome = export(file, Task(to, wish, clock, output, task, session, whose), watch)
    if print_json:
        typer.echo(printing.as_json(outcome))
    else:
        for sentence in printing.sentences(outcome):
            say(sentence)
    if not outcome.is_certain:
        raise typer.Exit(1)


@contextmanager
def _bars() -> Generator[Watch]:
    """Show a bar for each format on a terminal, until all is done."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(
        *columns,
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as shown:

        def watch(name: str, seconds: float) -> exporter.Progress:
            task = shown.add_task(name, total=max(seconds, 1e-9))
            return lambda done: shown.update(task, completed=done)

        yield watch
