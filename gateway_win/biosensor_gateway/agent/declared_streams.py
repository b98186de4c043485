"""Lists the streams of a status's devices: by their sensor's declaration, or by their own."""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_gateway.agent.status import DeclaredStream
from biosensor_gateway.devices.registry import declaration


def declared_streams(sensor: str, own: Sequence[DeclaredStream] = ()) -> tuple[DeclaredStream, ...]:
    """Return the streams of a device.

    Parameters
    ----------
    sensor
        As its identity has it.
    own
        What the status says that its settings declare.

    Raises
    ------
    SpecError
        If it declares nothing itself, and its sensor's declaration cannot be loaded.
    """
    if own:
        return tuple(own)
    return tuple(DeclaredStream.of(each) for each in declaration(sensor).streams)
