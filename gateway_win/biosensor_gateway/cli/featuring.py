"""Computes features, live or of a recording, and says how it goes."""

from __future__ import annotations

import asyncio
import json
import threading
from pathlib import Path

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl.network import configure_lsl
from biosensor_gateway.agent.feature_refusals import FeatureRefusals
from biosensor_gateway.cli.recordings import wrong_recording
from biosensor_gateway.cli.screen import say
from biosensor_gateway.features.errors import FeatureError, FeatureReason
from biosensor_gateway.features.live import Live
from biosensor_gateway.features.offline import SUFFIXES, compute
from biosensor_gateway.features.sources import Source
from biosensor_gateway.recording.xdf.printing import printable
from biosensor_gateway.settings.models import LslSettings
from biosensor_gateway.settings.places import state_folder

_AS_CONFIG = {
    FeatureReason.EXISTS: ConfigReason.EXISTS,
    FeatureReason.NOTHING: ConfigReason.WRONG_VALUE,
}


class _Saying:
    def found(self, source: Source) -> None:
        names = ", ".join(each.stream.data_name for each in source.features)
        say(printable(f"{source.name}: {names}"))

    def refused(self, sentence: str) -> None:
        say(printable(sentence))


async def watch_live(lsl: LslSettings) -> None:
    """Compute features of live streams until cancelled."""
    configure_lsl(lsl.overrides)
    stopping = threading.Event()
    say("looking for raw streams; end it by Ctrl-C")
    refusals = FeatureRefusals(state_folder())
    live = Live(_Saying(), report=refusals.write)
    work = asyncio.get_running_loop().run_in_executor(None, live.run, stopping)
    try:
        await asyncio.shield(work)
    except asyncio.CancelledError:
        stopping.set()
        await work
        raise
    finally:
        refusals.close()


def compute_recording(file: Path, output: Path | None, *, print_json: bool) -> None:
    """Compute features of a recording, and say what was written.

    Raises
    ------
    ConfigError
        If the recording cannot be read, holds nothing for it, or the target cannot be written.
    """
    target = output or file.with_name(f"{file.stem}_features.xdf")
    if target.suffix not in SUFFIXES:
        message = f"{target} has no suffix that is written; give it {' or '.join(SUFFIXES)}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    try:
        with wrong_recording():
            computed = compute(file, target)
    except FeatureError as error:
        reason = _AS_CONFIG.get(FeatureReason(error.reason), ConfigReason.UNREADABLE)
        raise ConfigError(reason, str(error)) from error
    if print_json:
        content = {
            "written": str(computed.written),
            "streams": computed.counts,
            "refused": computed.refused,
            "remarks": computed.remarks,
        }
        typer.echo(json.dumps(content, indent=2))
        return
    for sentence in (*computed.refused, *computed.remarks):
        say(printable(sentence))
    for name, count in computed.counts.items():
        say(printable(f"{name}: {count} samples"))
    say(f"wrote {computed.written}")
