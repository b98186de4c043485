"""The conversation with a Movesense sensor, and its settings."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Literal

from pydantic import Field

from biosensor_gateway.devices.discovery import by_advertisement
from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.movesense.driver.emitter import MovesenseEmitter
from biosensor_gateway.devices.movesense.driver.protocol import (
    HEART_RATE,
    MOVEMENT,
    TEMPERATURE,
    Measurement,
    ecg,
    movement,
)
from biosensor_gateway.devices.movesense.driver.session import MovesenseSession
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_pairing import Pairing
from biosensor_gateway.transports.nearby import Advertisement

_REGULAR = frozenset({"ecg", *MOVEMENT})
KIND = "Movesense"
ADVICE = (
    "snap it into its strap and put that on with wet electrodes, and end its connection to "
    "phones and other programs"
)


class MovesenseSettings(DeviceSettings):
    """Settings of one Movesense sensor."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the sensor, as scan shows it, or the serial number that "
        "is engraved on it; empty takes the only one in range.",
        examples=["174630000192"],
    )
    ecg: bool = Field(default=True, description="Whether the sensor sends its ECG.")
    ecg_rate_hz: Literal[125, 128, 200, 250, 256, 500, 512] = Field(
        default=200, description="Samples of ECG per second."
    )
    ecg_in_millivolts: bool = Field(
        default=False,
        description="Have the sensor itself convert the ECG: half of the bytes on the air, in "
        "steps of 1 microvolt and up to 32 mV; needs firmware 2.3. Otherwise it sends counts of "
        "0.38 microvolts, which are converted here.",
    )
    acc: bool = Field(default=True, description="Whether the sensor sends its acceleration.")
    gyro: bool = Field(default=True, description="Whether the sensor sends its rate of rotation.")
    mag: bool = Field(default=False, description="Whether the sensor sends the magnetic field.")
    imu_rate_hz: Literal[13, 26, 52, 104, 208] = Field(
        default=52,
        description="Samples per second of acceleration, rotation and magnetic field, which are "
        "measured together. All three at 208 may be more than a connection carries.",
    )
    pair: bool = Field(
        default=False,
        description="Pair before connecting, for a sensor that is set to demand it; it remembers "
        "one computer or phone at a time.",
    )

    @property
    def wanted(self) -> frozenset[str]:
        """Data names of the regular streams that are switched on."""
        switches = {"ecg": self.ecg, "acc": self.acc, "gyro": self.gyro, "mag": self.mag}
        return frozenset(name for name, is_on in switches.items() if is_on)


class MovesenseDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`.

    Parameters
    ----------
    silent
        Data names of the streams that are switched off.
    rates
        Nominal rates by data name, of these.
    """

    # Without ECG and movement there may be the temperature alone.
    silence_limit_s = 60.0

    def __init__(
        self, session: MovesenseSession, silent: frozenset[str], rates: dict[str, float]
    ) -> None:
        self._session = session
        self._silent = silent
        self._rates = rates

    async def connect(self) -> Connected:
        """Connect and start all measurements; see the protocol class."""
        info = await self._session.open()
        return Connected(info, self._rates, self._silent, denied=self._session.denied)

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes; see the protocol class."""
        await self._session.stream()

    async def close(self) -> None:
        """Stop all measurements, without waiting for answers, and disconnect."""
        await self._session.close()

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Start silent measurements anew; see the protocol class."""
        await self._session.enable_again(streams)


def _measurements(settings: MovesenseSettings) -> Sequence[Measurement]:
    found = [HEART_RATE, TEMPERATURE]
    moving = settings.wanted & frozenset(MOVEMENT)
    if moving:
        found.insert(0, movement(moving, settings.imu_rate_hz))
    if settings.ecg:
        found.insert(0, ecg(settings.ecg_rate_hz, in_millivolts=settings.ecg_in_millivolts))
    return found


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], MovesenseDriver]:
    """Share emitter and choice of the device between all connections."""
    own = own_settings(MovesenseSettings, settings)
    silent = _REGULAR - own.wanted
    emitter = MovesenseEmitter(sink, silent)
    choice = Choice(identify, KIND, own.device, ADVICE)
    measurements = _measurements(own)
    rates = {"ecg": float(own.ecg_rate_hz)}
    pairing = Pairing("yes" if own.pair else "no")
    rates |= dict.fromkeys(MOVEMENT, float(own.imu_rate_hz))

    def make() -> MovesenseDriver:
        link = BleLink(choice, sink.clock, pairing=pairing)
        session = MovesenseSession(link, emitter, sink, measurements)
        return MovesenseDriver(session, silent, rates)

    return make


def identify(seen: Advertisement) -> str | None:
    """Return the serial number from the name ``Movesense <serial>``; None for other devices."""
    kind, _, serial = seen.name.strip().partition(" ")
    return serial.strip() if kind == KIND else None


recognise = by_advertisement("movesense", identify)
# The third text of the greeting.
IDENTIFIERS = (re.compile(rb"\0([0-9A-Fa-f:-]{12,17})\0"),)
DRIVER = DriverEntry(MovesenseSettings, _make, recognise=recognise, identifiers=IDENTIFIERS)
