"""Options and arguments that several commands share."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason

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

RecordingArgument = Annotated[Path, typer.Argument(help="The recording.", show_default=False)]

# The part of a recording that a command works on.
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
        "--from",
        metavar="TIME",
        help="Since the start, such as 90.5 or 1:30.5, or a date and time.",
    ),
]
UntilOption = Annotated[str, typer.Option("--until", metavar="TIME", help="Likewise.")]


@contextmanager
def wrong_recording() -> Generator[None]:
    """Raise `ConfigError`, for exit code 2, if an argument is not a readable recording or bag."""
    from biosensor_gateway.recording.bag.types import BagError, BagReason  # not needed for help
    from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

    try:
        yield
    except RecordingError as error:
        # The argument was wrong; exit code 1 is for what is wrong in a recording.
        if error.reason in {
            RecordingReason.NOT_FOUND,
            RecordingReason.UNREADABLE,
            RecordingReason.NOT_XDF,
        }:
            raise ConfigError(ConfigReason.UNREADABLE, str(error)) from error
        raise
    except BagError as error:
        as_config = {
            BagReason.NOT_FOUND: ConfigReason.NOT_FOUND,
            BagReason.UNREADABLE: ConfigReason.UNREADABLE,
            BagReason.NOT_A_BAG: ConfigReason.UNREADABLE,
            BagReason.EXISTS: ConfigReason.EXISTS,
        }
        reason = as_config.get(error.reason) if isinstance(error.reason, BagReason) else None
        if reason is None:
            raise
        raise ConfigError(reason, str(error)) from error
