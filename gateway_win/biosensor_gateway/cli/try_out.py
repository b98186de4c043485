"""Commands that need no hardware: ``try`` and ``demo``; this module has what their help needs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_FOLDER = Path("biosensor-gateway-try")


def try_out(
    seconds: Annotated[
        float | None,
        typer.Option(
            min=1,
            help="End this many seconds after the sensors stream, though not before the recording.",
            show_default="Ctrl-C",
        ),
    ] = None,
    browser: Annotated[
        bool,
        typer.Option(
            "--open/--no-open", help="Open the page in the browser, or print its address."
        ),
    ] = True,
    folder: Annotated[
        Path,
        typer.Option(
            help="Folder for recording and tables; everything else is removed at the end."
        ),
    ] = _FOLDER,
    every: Annotated[
        bool,
        typer.Option("--all", help="Use a virtual device of each kind; keeps two cores busy."),
    ] = False,
) -> None:
    """Try it without hardware: a page with virtual sensors, a recording, and its tables.

    Shows the topics, too, if rclpy is installed. Your settings, your recordings and a running
    agent are not touched. Exit codes: 0 everything worked, 1 a stream is missing in the recording
    or something else failed, 3 this computer is too busy for all topics.
    """
    from biosensor_gateway.cli.trial import Trial  # takes a second

    raise typer.Exit(Trial(folder.absolute(), seconds, opens=browser).run(every=every))


def demo(
    seconds: Annotated[
        float | None,
        typer.Option(min=10, help="End this many seconds after the first sample."),
    ] = None,
) -> None:
    """Show all virtual devices on their way to ROS topics.

    Exit codes: 0 all of them arrived, 1 something is missing, 3 this computer is too busy.
    """
    from biosensor_gateway.demo import demonstration  # takes a second

    raise typer.Exit(demonstration.run(seconds))
