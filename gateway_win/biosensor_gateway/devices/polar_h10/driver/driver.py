"""The conversation with a Polar H10, and with others that have its PMD service."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Literal

import structlog
from pydantic import Field

from biosensor_common.errors import (
    CredentialError,
    CredentialReason,
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.ble_heart_rate.driver.protocol import HEART_RATE_SERVICE
from biosensor_gateway.devices.discovery import by_advertisement
from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.polar_h10.driver.control import Wanted
from biosensor_gateway.devices.polar_h10.driver.emitter import DATA_NAMES, PolarEmitter
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement, Setting
from biosensor_gateway.devices.polar_h10.driver.session import Plan, PolarSession
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_pairing import PAIR_DESCRIPTION, Pairing, PairSetting
from biosensor_gateway.transports.nearby import Advertisement

ECG_RATE_HZ = 130
PATIENCE_S = 5.0
FULL_FRAME = 110
"""Samples of three axes that differ by little, at most, with the MTU of Polar's devices."""
_ADVICE = "put it on with wet electrodes, and close the apps that use it"

_log = structlog.get_logger("biosensor_gateway.polar_h10")
MANUFACTURER_ID = 0x006B
_MODELS = frozenset({"H10"})


class PolarH10Settings(DeviceSettings):
    """Settings of one H10."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the strap, as scan shows it, or the id printed on it (8 "
        "characters); empty takes the only one in range.",
        examples=["A1B2C3D4"],
    )
    ecg: bool = Field(default=True, description="Whether the strap sends its ECG.")
    acc: bool = Field(default=True, description="Whether the strap sends its acceleration.")
    acc_rate_hz: Literal[25, 50, 100, 200] = Field(
        default=50,
        description="Samples of acceleration per second. More than 50 together with the ECG is too "
        "much for some Bluetooth adapters.",
    )
    acc_range_g: Literal[2, 4, 8] = Field(
        default=8, description="Largest acceleration that can be measured, in g."
    )
    pair: PairSetting = Field(default="auto", description=PAIR_DESCRIPTION)


class PolarDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`.

    Parameters
    ----------
    meet
        Makes the session; a second time where the device demands to be paired.
    silent
        Data names of the streams that the settings switch off.
    fallback_rates
        By data name the rates in Hz of streams that this device may lack, for their headers.
    """

    # A heart rate comes every second, every 5 s from an optical sensor that looks for intervals.
    silence_limit_s = 15.0

    def __init__(
        self,
        meet: Callable[[], PolarSession],
        pairing: Pairing,
        emitter: PolarEmitter,
        silent: frozenset[str],
        fallback_rates: Mapping[str, float] | None = None,
    ) -> None:
        self._meet = meet
        self._pairing = pairing
        self._silent = silent
        self._fallback_rates = fallback_rates or {}
        self._session = meet()
        self._emitter = emitter

    async def connect(self) -> Connected:
        """Connect and start all measurements; see the protocol class."""
        try:
            info = await self._session.open()
        except GatewayError as error:
            if not self._helps(error):
                raise
            _log.info("pairing, because the device does not answer unpaired", cause=str(error))
        else:
            return self._connected(info)
        # The attempt may have cost the connection, and BlueZ has tried to pair by itself.
        await self._session.close()
        self._pairing.note_demand()
        self._session = self._meet()
        try:
            info = await self._session.open(pair=not self._pairing.comes_first)
        except GatewayError as error:
            raise _pairing_failure(error, still_demands=self._helps(error)) from error
        return self._connected(info)

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes; see the protocol class."""
        await self._session.stream()

    async def close(self) -> None:
        """Stop all measurements, without waiting for the replies, and disconnect."""
        await self._session.close()

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Start silent measurements again, and subscribe to the heart rate once more."""
        await self._session.enable_again(streams)

    def _helps(self, error: GatewayError) -> bool:
        return self._pairing.helps(error, is_unanswered=self._session.is_unanswered)

    def _connected(self, info: DeviceInfo) -> Connected:
        denied = self._session.denied
        names = frozenset(self._emitter.data_names.values())
        refused = names - self._session.running - denied.keys()
        rates = self._session.rates
        # A frame of a slow measurement takes its time to fill.
        patience_s = max([PATIENCE_S, *(2 * FULL_FRAME / rate for rate in rates.values())])
        return Connected(
            info,
            {**self._fallback_rates, **rates},
            self._silent,
            refused=refused,
            denied=denied,
            due=self._session.due,
            patience_s=patience_s,
        )


def _pairing_failure(error: GatewayError, *, still_demands: bool) -> GatewayError:
    """Return what to raise when even a paired connection fails."""
    denied = isinstance(error, TransportError) and error.reason is TransportReason.DENIED
    if not denied and not still_demands:
        return error
    message = (
        f"{error}; pairing does not help: remove the sensor in the system's Bluetooth settings, "
        "then start again"
    )
    if isinstance(error, TransportError) and not denied:
        return ProtocolError(ProtocolReason.NO_REPLY, message)
    return CredentialError(CredentialReason.REJECTED, message)


def _wanted(settings: PolarH10Settings) -> Sequence[Wanted]:
    ecg = Wanted(Measurement.ECG, {Setting.SAMPLE_RATE: ECG_RATE_HZ})
    acceleration = Wanted(
        Measurement.ACCELERATION,
        {Setting.SAMPLE_RATE: settings.acc_rate_hz, Setting.RANGE: settings.acc_range_g},
    )
    return [*([ecg] if settings.ecg else []), *([acceleration] if settings.acc else [])]


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], PolarDriver]:
    """Share emitter and choice of the device between all connections."""
    own = own_settings(PolarH10Settings, settings)
    emitter = PolarEmitter(sink)
    choice = Choice(identify, "Polar H10", own.device, _ADVICE)
    wanted = _wanted(own)
    plan = Plan(lambda _: wanted)
    silent = frozenset(DATA_NAMES.values()) - {DATA_NAMES[each.measurement] for each in wanted}

    pairing = Pairing(own.pair)

    def meet() -> PolarSession:
        return PolarSession(BleLink(choice, sink.clock, pairing=pairing), emitter, plan)

    return lambda: PolarDriver(meet, pairing, emitter, silent)


def identify(seen: Advertisement, models: Collection[str] = _MODELS) -> str | None:
    """Return the id printed on a sensor of these models, None for anything else.

    Its name is ``Polar <model> <id>``, which comes in the scan response only.
    """
    words = seen.name.split()
    if len(words) < 3 or words[0] != "Polar" or " ".join(words[1:-1]) not in models:
        return None
    is_polar = MANUFACTURER_ID in seen.manufacturer_data or HEART_RATE_SERVICE in seen.service_uuids
    return words[-1] if is_polar else None


recognise = by_advertisement("polar_h10", identify)
DRIVER = DriverEntry(PolarH10Settings, _make, recognise=recognise)
