"""``biosensor-gateway features``: what a robot can act on, from raw streams."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from biosensor_gateway.cli.loading import settings_or_defaults
from biosensor_gateway.cli.options import JsonOption, SettingsOption


def features(
    file: Annotated[
        Path | None,
        typer.Argument(help="A recording (XDF), instead of live streams.", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="New .xdf or .csv, instead of NAME_features.xdf beside the recording.",
            show_default=False,
        ),
    ] = None,
    print_json: JsonOption = False,
    settings: SettingsOption = None,
) -> None:
    """Send beats, skin responses, breaths and more of raw streams as streams, until Ctrl-C.

    Raw streams are found by their LSL type: ECG, PPG, RR, GSR, Respiration
    and Accelerometer, of our devices and of other programs that say their
    unit. The node publishes what comes out beside the device's own topics.
    Of a recording the same is computed by the same code, and written.
    """
    from biosensor_gateway.cli.featuring import compute_recording, watch_live  # numpy, LSL

    if file is not None:
        compute_recording(file, output, print_json=print_json)
        return
    if output is not None or print_json:
        raise typer.BadParameter("--output and --json are for a recording; name one")
    from biosensor_gateway.system.shutdown import until_signalled

    lsl = settings_or_defaults(settings).lsl
    asyncio.run(until_signalled(lambda: watch_live(lsl)))
