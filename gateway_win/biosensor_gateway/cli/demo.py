"""``biosensor-gateway demo``."""

from __future__ import annotations

from typing import Annotated

import typer


def demo(
    seconds: Annotated[
        float | None,
        typer.Option(min=10, help="End after so many seconds, counted from the first sample."),
    ] = None,
) -> None:
    """Show all virtual devices on their way to ROS topics.

    Exit codes: 0 all of them arrived, 1 something is missing, 3 this computer is too busy.
    """
    from biosensor_gateway.demo import demonstration  # takes a second

    raise typer.Exit(demonstration.run(seconds))
