"""``biosensor-gateway stop``."""

from __future__ import annotations

from typing import Annotated

import typer

from biosensor_gateway.agent.stopping import USUAL_LIMIT_S, stop_agent
from biosensor_gateway.settings.places import state_folder


def stop(
    timeout: Annotated[
        float, typer.Option(min=1, help="How many seconds to wait until the agent has ended.")
    ] = USUAL_LIMIT_S,
) -> None:
    """End the running agent; exit code 1 if none runs or it does not end in time."""
    typer.echo(stop_agent(state_folder(), timeout))
