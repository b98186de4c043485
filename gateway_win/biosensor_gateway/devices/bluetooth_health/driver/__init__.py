"""Driver for any device with one of the supported services."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from pydantic import Field

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.ble_heart_rate.driver import Strap
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.ble_session import BleConnection
from biosensor_gateway.devices.bluetooth_health.driver.services import ROWS, SPOT_CHECK, Row
from biosensor_gateway.devices.driver import Connected, DriverEntry, by_advertisement, own_settings
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import UNLIKELY_ERROR, AttError, Pairing
from biosensor_gateway.transports.nearby import Advertisement

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

KIND = "health device"
_ADVICE = "switch it on or put it on, and disconnect it from phones"


class HealthDeviceSettings(DeviceSettings):
    """Settings of one health or sports device."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the device, as scan shows it, or its name; if empty, the "
        "only one in range that no other table uses.",
        examples=["C0:FF:EE:12:34:56"],
    )
    wheel_mm: int = Field(
        default=2105,
        ge=100,
        le=5000,
        description="Circumference of the wheel in millimetres, for the speed of a bicycle.",
    )
    pair: bool = Field(
        default=False, description="Pair before connecting, for devices that require it."
    )


class HealthEmitter:
    """Converts values to samples; one instance per device, over all its connections.

    These services have no timestamps, or timestamps of a manually set clock, so samples get their
    arrival time.

    Parameters
    ----------
    wheel_m
        Circumference of the wheel.
    """

    def __init__(self, sink: DeviceSink, wheel_m: float) -> None:
        self.strap = StrapEmitter(sink)  # Emits battery and signal strength.
        self._sink = sink
        self._wheel_m = wheel_m
        self.reconnected()

    def reconnected(self) -> None:
        """Prepare for a new connection of the same device."""
        self._samples = {row.characteristic: row.sample(self._wheel_m) for row in ROWS}

    def take(self, row: Row, data: bytes, arrival_s: float) -> None:
        """Emit the samples of a value; a truncated one is counted and dropped."""
        found = row.parse(data)
        if found is None:
            self._sink.dropped_bytes += len(data)
            return
        self._sink.heard(row.stream)
        # nothing is dropped: these are labels
        self._sink.lacking[row.stream] = [
            label for label, field in row.optional if field not in found
        ]
        sample = self._samples[row.characteristic](found, arrival_s)
        contact = row.contact(found) if row.contact is not None else None
        if sample is not None and contact is not False:
            self._sink.emit_at(row.stream, [sample], [arrival_s])
            self._sink.note_arrival(row.stream, arrival_s)
        if contact is not None:
            self._sink.emit_at("quality", [[float(contact)]], [arrival_s])


class HealthDeviceDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    # Some devices send nothing until a measurement is made; a lost link is detected separately.
    silence_limit_s = 3600.0

    def __init__(self, link: BleLink, emitter: HealthEmitter) -> None:
        self._link = link
        self._emitter = emitter
        self._strap = Strap(link, emitter.strap)
        self._connection = BleConnection(link)

    async def connect(self) -> Connected:
        """Connect and subscribe; see the protocol class."""
        await self._connection.connect()
        self._emitter.reconnected()
        rows = [row for row in ROWS if self._link.has(row.characteristic)]
        if not rows:
            raise self._has_none()
        info = await self._strap.identify()
        errors = {row: await self._subscribe(row) for row in rows}
        denied = {
            row.stream: f"its service does not allow subscriptions: ATT error 0x{error.code:02X}"
            for row, error in errors.items()
            if error is not None
        }
        if len(denied) == len(rows):
            raise self._refusal(errors)
        denied |= await self._strap.ask_for_battery()
        refused = frozenset(row.stream for row in ROWS) - {row.stream for row in rows}
        due = {row.stream: row.due_s for row in rows if row.due_s and row.stream not in denied}
        return Connected(info, refused=refused, denied=denied, due=due)

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Subscribe to everything again, because rare data may be missing, too."""
        del streams
        for row in ROWS:
            if self._link.has(row.characteristic):
                with suppress(AttError):
                    await self._link.unsubscribe(row.characteristic)
                await self._subscribe(row)

    async def stream(self) -> None:
        """Emit what the device sends, starting with what the link has buffered."""
        listen = partial(self._connection.listen, self._take)
        await self._connection.run(
            self._emitter.strap.signal_strength, self._strap.watch_battery, listen
        )

    async def close(self) -> None:
        """Try to unsubscribe within a short time, and disconnect."""
        await self._connection.close(self._unsubscribe)

    async def _unsubscribe(self) -> None:
        for row in ROWS:
            if self._link.has(row.characteristic):
                await self._link.unsubscribe(row.characteristic)

    async def _subscribe(self, row: Row) -> AttError | None:
        """Subscribe; return the error of a refusal."""
        try:
            await self._link.subscribe(row.characteristic)
        except AttError as error:
            return error
        return None

    def _has_none(self) -> ProtocolError:
        message = f"{self._link.what} has none of the services; choose another `device`"
        if self._link.has(SPOT_CHECK):
            message = (
                f"{self._link.what} makes only spot checks, one value at the end of a "
                "measurement; choose an oximeter that measures continuously"
            )
        return ProtocolError(ProtocolReason.UNSUPPORTED, message)

    def _refusal(self, errors: Mapping[Row, AttError | None]) -> ProtocolError:
        """Return the error if every characteristic is refused."""
        found = [error for error in errors.values() if error is not None]
        if any(error.wants_pairing or error.code == UNLIKELY_ERROR for error in found):
            message = f"{self._link.what} answers only when paired; set pair = true for it"
            return ProtocolError(ProtocolReason.REFUSED, message)
        return found[0]

    def _take(self, notification: Notification) -> None:
        row = next((each for each in ROWS if each.characteristic == notification.uuid), None)
        if row is None:
            self._strap.take(notification)
        else:
            self._emitter.take(row, notification.data, notification.arrival)


def identify(seen: Advertisement) -> str | None:
    """Return the address of a device that advertises one of the services, else None."""
    return None if _title(seen) is None else seen.address


# A device that a specific driver recognises is left to that driver.
recognise = by_advertisement("bluetooth_health", identify)


def _title(seen: Advertisement) -> str | None:
    titles = (row.title for row in ROWS if row.service in seen.service_uuids)
    return next(titles, None)


def _any(seen: Advertisement) -> str:
    return seen.address


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], HealthDeviceDriver]:
    """Share the emitter and the device selection between all connections."""
    own = own_settings(HealthDeviceSettings, settings)
    emitter = HealthEmitter(sink, own.wheel_mm / 1000)
    kind = _any if own.device else identify
    pairing = Pairing("yes" if own.pair else "no")
    choice = Choice(kind, KIND, own.device, _ADVICE, is_generic=True)
    return lambda: HealthDeviceDriver(BleLink(choice, sink.clock, pairing=pairing), emitter)


DRIVER = DriverEntry(HealthDeviceSettings, _make, recognise=recognise)
