"""Import what a run needs, and wait until this process is the one that runs."""

from __future__ import annotations

from importlib import import_module

from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.system.standby import await_turn


def stand_by(simulate: str) -> None:
    """Wait for the turn with everything imported; claim and open nothing before.

    Parameters
    ----------
    simulate
        Virtual devices that will run, as `run` has it; empty for those of the settings.
    """
    import_module("biosensor_gateway.cli.streaming")
    if simulate:
        from biosensor_gateway.demo import virtual_devices  # only on request

        virtual_devices.import_all(simulate.split(","))
    # To look each of them up imports its driver.
    dict(settings_models())
    await_turn()
