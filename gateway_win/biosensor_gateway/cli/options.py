"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SettingsOption = Annotated[
    Path | None, typer.Option("--settings", help="Settings file instead of the usual one.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
SimulateOption = Annotated[
    str,
    typer.Option(
        help="Use these virtual devices instead (comma-separated, or all); with @P01, worn by P01."
    ),
]
FaultOption = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        help="Give the virtual devices a fault: [SENSOR:]KIND[:VALUE]@START, as in drop:5s@10s "
        "(repeatable).",
    ),
]

# What of a recording is wanted.
StreamsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--streams",
        metavar="PATTERN",
        help="Only streams of this name or source_id; * and ? stand for others (repeatable).",
    ),
]
ParticipantOption = Annotated[str, typer.Option(help="Only this person's streams.")]
WithoutOption = Annotated[
    str, typer.Option("--without", metavar="PERSON", help="All streams but those of this person.")
]
FromOption = Annotated[
    str,
    typer.Option(
        "--from", metavar="TIME", help="Since the begin, as 90.5 or 1:30.5, or a date and time."
    ),
]
UntilOption = Annotated[str, typer.Option("--until", metavar="TIME", help="Likewise.")]
