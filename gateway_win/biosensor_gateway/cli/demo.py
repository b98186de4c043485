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
    """Show all virtual devices on their way to ROS topics."""
    from biosensor_gateway.demo import demonstration  # takes a second

    raise typer.Exit(demonstration.run(seconds))
