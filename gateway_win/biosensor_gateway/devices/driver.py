"""The interface of drivers, how a sensor offers its own, and how its devices are found."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar, runtime_checkable

from biosensor_common.spec import DeviceInfo, SensorSpec
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.streaming.silence import PATIENCE_S
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

if TYPE_CHECKING:
    # Brings the keyring, which few sensors need.
    from biosensor_gateway.settings.secrets import SecretName


@dataclass(frozen=True, slots=True)
class Found:
    """A device that could be added to the settings.

    Attributes
    ----------
    name
        What a person calls it: the advertised name, an id.
    settings
        ``unit`` and whatever else leads the driver to it; scalars only.
    """

    sensor: str
    name: str
    settings: Mapping[str, str | int | float | bool]
    rssi_dbm: int | None = None


def by_advertisement(
    sensor: str, identify: Callable[[Advertisement], str | None]
) -> Callable[[Advertisement | SerialPort], Found | None]:
    """Return what recognises a Bluetooth LE sensor among all that is within reach.

    Parameters
    ----------
    identify
        Returns what tells one device of the sensor from another, which becomes its unit; empty
        where only its address does, None for devices that are not of the sensor.
    """

    def recognise(seen: Advertisement | SerialPort) -> Found | None:
        identity = identify(seen) if isinstance(seen, Advertisement) else None
        if not isinstance(seen, Advertisement) or identity is None:
            return None
        settings = {"unit": identity or seen.address, "device": seen.address}
        return Found(sensor, seen.name.strip() or seen.address, settings, seen.rssi_dbm)

    return recognise


def by_port_name(sensor: str, pattern: str) -> Callable[[Advertisement | SerialPort], Found | None]:
    """Return what recognises a paired device of Bluetooth Classic by its name.

    Parameters
    ----------
    pattern
        Of its whole name; the first group is the number on the case, its unit.
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
    """What a driver knows once its device is connected.

    Attributes
    ----------
    rates
        Nominal rate in Hz by data name, for streams declared ``FROM_DEVICE``.
    silent
        Data names of the streams that the settings switch off, or that this model has only in name.
    refused
        Data names of the streams that this device does not send, or not to us.
    denied
        By data name, why a stream that is wanted does not come, with what to do about it; a
        clause. It is shown until data of the stream come, and nobody else is to ask for them.
    due
        Longest absence in seconds of streams that come all the time without a rate.
    patience_s
        How long a regular stream may be absent, 20 samples at least. Streams that are silent
        for longer are enabled again, then the connection is made again.
    """

    info: DeviceInfo = field(default_factory=DeviceInfo)
    rates: Mapping[str, float] = field(default_factory=dict[str, float])
    silent: frozenset[str] = frozenset()
    refused: frozenset[str] = frozenset()
    denied: Mapping[str, str] = field(default_factory=dict[str, str])
    due: Mapping[str, float] = field(default_factory=dict[str, float])
    patience_s: float = PATIENCE_S


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


@runtime_checkable
class EnablesAgain(Protocol):
    """What a driver may offer besides; without it, silent streams cost the connection."""

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Ask the device once more for streams of which nothing comes; `stream` goes on.

        Whether it has helped, the streams themselves tell.

        Parameters
        ----------
        streams
            Data names; what they share with others may be started again with them.

        Raises
        ------
        TransportError, ProtocolError
            It cannot help; the connection has to be made again.
        """
        ...


class DriverEntry(NamedTuple):
    """What a driver module offers as its ``DRIVER``.

    Attributes
    ----------
    settings
        Model of the device's table in the settings file.
    make
        Called once a device; returns what makes a driver for each connection.
    recognise
        Tells whether an advertisement or a serial port is such a device; None for
        sensors that have neither.
    find
        Asks the vendor's services for their devices, given the settings of all configured
        devices of the sensor, which say where services are; None where there is no service.
        Raises a GatewayError if the service does not answer.
    secrets
        What the vendor's service asks for.
    unlicensed
        Asks the vendor's service what the user's licence does not cover, a clause each; None
        where nothing needs a licence. Raises a GatewayError if there is no answer.
    declare
        Says what one device emits where that is for its settings to say; the declaration's name
        is the settings' `sensor_name`. None where the sensor's declaration holds for every device.
    identifiers
        Where payloads say whose device it is, besides its address, its name and the serial number
        of `Connected`: the first group of each is replaced in what is given away. One called
        ``secret`` is not even shown.
    forms
        Settings that are texts and say nothing but what data look like: they are given away.
    """

    settings: type[DeviceSettings]
    make: Callable[[DeviceSettings, Sink], Callable[[], Driver]]
    recognise: Callable[[Advertisement | SerialPort], Found | None] | None = None
    find: Callable[[Sequence[DeviceSettings]], Awaitable[Sequence[Found]]] | None = None
    secrets: tuple[SecretName, ...] = ()
    unlicensed: Callable[[DeviceSettings], Awaitable[Sequence[str]]] | None = None
    declare: Callable[[DeviceSettings], SensorSpec] | None = None
    identifiers: tuple[re.Pattern[bytes], ...] = ()
    forms: frozenset[str] = frozenset()


def own_settings(model: type[_Settings], settings: DeviceSettings) -> _Settings:
    """Return a device's settings as those of a driver's own model.

    Raises
    ------
    TypeError
        They are another sensor's.
    """
    if not isinstance(settings, model):
        raise TypeError(f"{type(settings).__name__} are not {model.__name__}")
    return settings
