"""What the supervisor asks of every driver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from biosensor_common.spec import DeviceInfo


@dataclass(frozen=True, slots=True)
class Connected:
    """What a driver knows once its device is connected.

    Attributes
    ----------
    rates
        Nominal rate in Hz by data name, for streams declared ``FROM_DEVICE``.
    silent
        Data names of the streams that the settings switch off.
    """

    info: DeviceInfo = field(default_factory=DeviceInfo)
    rates: Mapping[str, float] = field(default_factory=dict[str, float])
    silent: frozenset[str] = frozenset()


class Driver(Protocol):
    """The conversation with one device, for one connection.

    Attributes
    ----------
    silence_limit_s
        The supervisor gives a connection up after so many seconds without
        anything valid from the device.
    """

    silence_limit_s: float

    async def connect(self) -> Connected:
        """Open the link and start the device.

        What the device sends meanwhile is kept for :meth:`stream`.

        Raises
        ------
        TransportError, ProtocolError, CredentialError
            The device cannot be used now.
        """
        ...

    async def stream(self) -> None:
        """Pass on what the device measures, until the link ends or the task is cancelled.

        Raises
        ------
        TransportError, ProtocolError
            The connection ended.
        """
        ...

    async def close(self) -> None:
        """Stop the device without waiting for it, and close the link; never raises."""
        ...
