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
