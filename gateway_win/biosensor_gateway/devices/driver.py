"""The interface of drivers, their registration, and how their devices are found."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar, runtime_checkable

from biosensor_common.spec import DeviceInfo, SensorSpec
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.streaming.silence import PATIENCE_S
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

if TYPE_CHECKING:
    # Imports the keyring library, which few sensors need.
    from biosensor_gateway.settings.secrets import SecretName
    from biosensor_gateway.streaming.sink import DeviceSink


@dataclass(frozen=True, slots=True)
class Found:
    """A device that could be added to the settings."""

    sensor: str
    name: str  # Name for the user, such as the advertised name or an id.
    # `unit` and the settings with which the driver finds it; scalars only.
    settings: Mapping[str, str | int | float | bool]
    rssi_dbm: int | None = None


def by_advertisement(
    sensor: str, identify: Callable[[Advertisement], str | None]
) -> Callable[[Advertisement | SerialPort], Found | None]:
    """Return a function that recognises a sensor's devices by their advertisements.

    Parameters
    ----------
    identify
        Returns the identity of a device, which becomes its unit; empty if only the address
        identifies it, None for other sensors' devices.
    """

    def recognise(seen: Advertisement | SerialPort) -> Found | None:
        identity = identify(seen) if isinstance(seen, Advertisement) else None
        if not isinstance(seen, Advertisement) or identity is None:
            return None
        settings = {"unit": identity or seen.address, "device": seen.address}
        return Found(sensor, seen.name.strip() or seen.address, settings, seen.rssi_dbm)

    return recognise


def by_port_name(sensor: str, pattern: str) -> Callable[[Advertisement | SerialPort], Found | None]:
    """Return a function that recognises paired Bluetooth Classic devices by name.

    Parameters
    ----------
    pattern
        Pattern of the full name; the first group is the number on the case, its unit.
    """
    form = re.compile(pattern)

    def recognise(seen: Advertisement | SerialPort) -> Found | None:
        name = form.fullmatch(seen.remote_name) if isinstance(seen, SerialPort) else None
        if not isinstance(seen, SerialPort) or name is None:
            return None
        settings = {"unit": name[1].upper(), "port": seen.port}
        return Found(sensor, seen.remote_name, settings)

    return recognise


_Settings = TypeVar("_Settings", bound=DeviceSettings)


@dataclass(frozen=True, slots=True)
class Connected:
    """Information about a connected device."""

    info: DeviceInfo = field(default_factory=DeviceInfo)
    # Nominal rate in Hz by data name, for streams declared `FROM_DEVICE`.
    rates: Mapping[str, float] = field(default_factory=dict[str, float])
    # Data names of streams that the settings switch off or that this model does not have.
    silent: frozenset[str] = frozenset()
    # Data names of streams that this device does not send, or not to us.
    refused: frozenset[str] = frozenset()
    # By data name, a clause about why a wanted stream is not sent and what to do. It is shown until
    # the stream's data arrive, and the stream is not monitored until then.
    denied: Mapping[str, str] = field(default_factory=dict[str, str])
    # Maximum gap in seconds of irregular streams that are sent continuously.
    due: Mapping[str, float] = field(default_factory=dict[str, float])
    # Maximum gap of a regular stream, but at least 20 samples. Streams that are silent for longer
    # are restarted, and then the device is reconnected.
    patience_s: float = PATIENCE_S


class Driver(Protocol):
    """The interface of a driver: one connection to one device."""

    # The supervisor closes a connection after this time without valid data from the device.
    silence_limit_s: float

    async def connect(self) -> Connected:
        """Open the link and start the device.

        Data received in the meantime are buffered for :meth:`stream`.

        Raises
        ------
        TransportError, ProtocolError, CredentialError
            If the device cannot be used now.
        """
        ...

    async def stream(self) -> None:
        """Pass on the device's data until the link ends or the task is cancelled.

        Raises
        ------
        TransportError, ProtocolError
            If the connection ended.
        """
        ...

    async def close(self) -> None:
        """Stop the device without waiting for an answer, and close the link; never raises."""
        ...


@runtime_checkable
class EnablesAgain(Protocol):
    """Optional interface of drivers; without it, silent streams cause a reconnect."""

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Restart silent streams on the device, while `stream` continues.

        Success shows in the streams themselves.

        Parameters
        ----------
        streams
            Data names; streams that share a measurement with them may be restarted, too.

        Raises
        ------
        TransportError, ProtocolError
            If it is not possible, so a reconnect is needed.
        """
        ...


class DriverEntry(NamedTuple):
    """A driver's registration, the ``DRIVER`` of its module."""

    settings: type[DeviceSettings]  # Model of the device's table in the settings file.
    # Called once per device; returns a function that creates a driver for each connection.
    make: Callable[[DeviceSettings, DeviceSink], Callable[[], Driver]]
    # Recognises a device by an advertisement or a serial port; None for sensors that have neither.
    recognise: Callable[[Advertisement | SerialPort], Found | None] | None = None
    # Queries the vendor's services for their devices, given the settings of all configured devices
    # of the sensor, which contain the services' addresses; None if there is no service. Raises a
    # GatewayError if a service does not answer.
    find: Callable[[Sequence[DeviceSettings]], Awaitable[Sequence[Found]]] | None = None
    secrets: tuple[SecretName, ...] = ()  # Credentials for the vendor's service.
    # Queries the vendor's service for what the user's licence does not cover, as clauses; None if
    # no licence is needed. Raises a GatewayError if there is no answer.
    unlicensed: Callable[[DeviceSettings], Awaitable[Sequence[str]]] | None = None
    # Returns the declaration of one device if it depends on its settings, named after their
    # `sensor_name`. None if the sensor's declaration applies to every device.
    declare: Callable[[DeviceSettings], SensorSpec] | None = None
    # Patterns of identifiers in payloads, besides address, name and serial number of `Connected`:
    # the first group is replaced before data are shared. A group named `secret` is not even
    # displayed; one named `address` is six bytes, not text.
    identifiers: tuple[re.Pattern[bytes], ...] = ()
    # Text settings that only describe the data format, so they may be shared.
    forms: frozenset[str] = frozenset()


def own_settings(model: type[_Settings], settings: DeviceSettings) -> _Settings:
    """Return a device's settings, checked to be of the driver's own model.

    Raises
    ------
    TypeError
        If they belong to another sensor.
    """
    if not isinstance(settings, model):
        raise TypeError(f"{type(settings).__name__} are not {model.__name__}")
    return settings
