"""Arguments and messages that all commands on recordings share."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.recording.bag.errors import BagError, BagReason
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

RecordingArgument = Annotated[Path, typer.Argument(help="The recording.", show_default=False)]

# The argument was wrong; exit code 1 is for what is wrong in a recording.
_WRONG_ARGUMENT = frozenset(
    {RecordingReason.NOT_FOUND, RecordingReason.UNREADABLE, RecordingReason.NOT_XDF}
)

_WRONG_BAG = {
    BagReason.NOT_FOUND: ConfigReason.NOT_FOUND,
    BagReason.UNREADABLE: ConfigReason.UNREADABLE,
    BagReason.NOT_A_BAG: ConfigReason.UNREADABLE,
    BagReason.EXISTS: ConfigReason.EXISTS,
}


@contextmanager
def wrong_recording() -> Generator[None]:
    """Say of a recording or a bag that is none that the command is wrong."""
    try:
        yield
    except RecordingError as error:
        if error.reason in _WRONG_ARGUMENT:
            raise ConfigError(ConfigReason.UNREADABLE, str(error)) from error
        raise
    except BagError as error:
        reason = _WRONG_BAG.get(error.reason) if isinstance(error.reason, BagReason) else None
        if reason is None:
            raise
        raise ConfigError(reason, str(error)) from error
