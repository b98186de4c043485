"""``biosensor-gateway features``: computes features of live streams or of a recording.

Functions import what needs numpy or LSL, so that the help is shown quickly.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.terminal import columns, wrapped
from biosensor_gateway.cli.options import (
    JsonOption,
    SettingsOption,
    settings_or_defaults,
    wrong_recording,
)
from biosensor_gateway.cli.output import say
from biosensor_gateway.recording.xdf.report_text import printable
from biosensor_gateway.settings.models import LslSettings
from biosensor_gateway.settings.places import state_folder

if TYPE_CHECKING:
    from biosensor_common.refusal import Refusals
    from biosensor_gateway.features.sources import Source


_LOOK_S = 2.0
"""How often the session of the agent is looked at."""


def features(
    file: Annotated[
        Path | None,
        typer.Argument(help="A recording (XDF), instead of live streams.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="New .xdf or .csv, instead of NAME_features.xdf next to the recording.",
            show_default=False,
        ),
    ] = None,
    print_json: JsonOption = False,
    settings: SettingsOption = None,
) -> None:
    """Compute beats, skin responses, breaths and more, and send them as streams until Ctrl-C.

    Raw streams are found by their LSL type: ECG, PPG, RR, GSR, Respiration
    and Accelerometer, from our devices and from other programs that declare
    their unit. The node publishes the features alongside the device's own
    topics. For a recording, the same code computes them and writes a file.
    """
    from biosensor_common.nonblocking_writer import console_relayed
    from biosensor_gateway.system.shutdown import requests_interrupt, until_signalled

    if file is not None:
        with requests_interrupt():
            compute_recording(file, output, print_json=print_json)
        return
    if output is not None or print_json:
        raise typer.BadParameter("--output and --json are for a recording; name one")
    lsl = settings_or_defaults(settings).lsl
    listener = _PrintingListener(columns(sys.stdout))
    # A terminal that is held with Ctrl-S would hold up the features of everybody.
    with console_relayed():
        asyncio.run(until_signalled(lambda: watch_live(lsl, listener)))


class _PrintingListener:
    def __init__(self, width: int | None) -> None:
        self._width = width

    def found(self, source: Source) -> None:
        names = ", ".join(each.stream.data_name for each in source.features)
        self.say(printable(f"{source.name}: {names}"))

    def refused(self, sentence: str) -> None:
        self.say(printable(sentence))

    def say(self, sentence: str) -> None:
        typer.echo(wrapped(sentence, self._width, 2))


async def watch_live(lsl: LslSettings, listener: _PrintingListener) -> None:
    """Compute features of live streams until cancelled."""
    from biosensor_common.lsl.network import configure_lsl
    from biosensor_gateway.agent.feature_refusals import FeatureRefusals
    from biosensor_gateway.features.live import Live

    configure_lsl(lsl.overrides)
    stopping = threading.Event()
    listener.say("looking for raw streams; end it by Ctrl-C")
    refusals = FeatureRefusals(state_folder())
    live = Live(listener, report=refusals.write)
    work = asyncio.get_running_loop().run_in_executor(None, live.run, stopping)
    watching = asyncio.create_task(watch_session(lsl, live.refusals))
    try:
        await asyncio.shield(work)
    except asyncio.CancelledError:
        stopping.set()
        await work
        raise
    finally:
        watching.cancel()
        refusals.close()


async def watch_session(lsl: LslSettings, refusals: Refusals) -> None:
    """Report while the agent of this computer is in another LSL session than this program."""
    from biosensor_common.refusal import Refusal
    from biosensor_gateway.agent.status_file import other_session, read_status

    while True:
        session = ""
        with contextlib.suppress(ConfigError):
            status = read_status(state_folder())
            session = status["session"] if other_session(status, lsl.overrides) else ""
        why = (
            f"the agent sends in the LSL session {session}, and `features` looks in another one; "
            "end it and start it again"
        )
        refusals.hold(Refusal.NO_FEATURES, bool(session), about="this agent", why=why)
        await asyncio.sleep(_LOOK_S)


def compute_recording(file: Path, output: Path | None, *, print_json: bool) -> None:
    """Compute features of a recording, write them, and print what was written.

    Raises
    ------
    ConfigError
        If the recording cannot be read or has no raw stream, or the target exists.
    FeatureError
        If the target cannot be written.
    """
    from biosensor_common.lsl.network import configure_lsl
    from biosensor_gateway.features.offline import SUFFIXES, compute
    from biosensor_gateway.features.sources import FeatureError, FeatureReason

    target = output or file.with_name(f"{file.stem}_features.xdf")
    if target.suffix not in SUFFIXES:
        message = f"{target} has no suffix that can be written; give it {' or '.join(SUFFIXES)}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    # Headers are made by liblsl, which otherwise says where it has its settings from.
    configure_lsl(LslSettings().overrides)
    try:
        with wrong_recording():
            computed = compute(file, target)
    except FeatureError as error:
        if error.reason is FeatureReason.UNWRITABLE:
            raise
        as_config = {
            FeatureReason.EXISTS: ConfigReason.EXISTS,
            FeatureReason.NOTHING: ConfigReason.WRONG_VALUE,
        }
        reason = as_config.get(FeatureReason(error.reason), ConfigReason.UNREADABLE)
        raise ConfigError(reason, str(error)) from error
    if print_json:
        content = {
            "written": str(computed.written),
            "streams": computed.counts,
            "refused": computed.refused,
            "remarks": computed.remarks,
        }
        typer.echo(json.dumps(content, indent=2))
        if not computed.is_whole:
            raise typer.Exit(1)
        return
    for sentence in (*computed.refused, *computed.remarks):
        say(printable(sentence))
    for name, count in computed.counts.items():
        say(printable(f"{name}: {count} samples"))
    say(f"wrote {computed.written}")
    if not computed.is_whole:
        raise typer.Exit(1)
