"""The conversation with a Polar Verity Sense, OH1 or 360."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import DriverEntry, own_settings
from biosensor_gateway.devices.polar_h10.driver.driver import PolarDriver
from biosensor_gateway.devices.polar_h10.driver.measurements import Wanted
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement, Setting
from biosensor_gateway.devices.polar_h10.driver.session import Plan, PolarSession
from biosensor_gateway.devices.polar_verity_sense.driver.discovery import identify, recognise
from biosensor_gateway.devices.polar_verity_sense.driver.emitter import DATA_NAMES, OpticalEmitter
from biosensor_gateway.devices.polar_verity_sense.driver.firmware import true_ppg_rates
from biosensor_gateway.devices.polar_verity_sense.driver.modes import LEAVE, SdkMode
from biosensor_gateway.devices.polar_verity_sense.driver.settings import PolarVeritySenseSettings
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_pairing import Pairing

_ADVICE = "switch it on to its heart-rate mode, and close the apps that use it"


def wanted_of(own: PolarVeritySenseSettings, info: DeviceInfo) -> Sequence[Wanted]:
    """Return the measurements that the settings ask for, of a device that tells this of itself."""
    rate, reach = Setting.SAMPLE_RATE, Setting.RANGE
    light = Wanted(
        Measurement.PPG,
        {rate: own.ppg_rate_hz},
        true_ppg_rates(info, sdk_mode=own.sdk_mode),
    )
    wanted = [
        light,
        Wanted(Measurement.ACCELERATION, {rate: own.acc_rate_hz, reach: own.acc_range_g}),
        Wanted(Measurement.GYROSCOPE, {rate: own.gyro_rate_hz, reach: own.gyro_range_deg_s}),
        Wanted(Measurement.MAGNETOMETER, {rate: own.mag_rate_hz}),
        Wanted(Measurement.PULSE_INTERVALS),
    ]
    off = off_by(own)
    return [each for each in wanted if DATA_NAMES[each.measurement] not in off]


def off_by(own: PolarVeritySenseSettings) -> frozenset[str]:
    """Return the data names of the streams that the settings switch off."""
    on = {"ppi": own.ppi, "ppg": own.ppg, "acc": own.acc, "gyro": own.gyro, "mag": own.mag}
    off = {name for name, is_on in on.items() if not is_on}
    return frozenset(off | {"hr", "ppi"} if own.sdk_mode else off)


def _asked_rates(own: PolarVeritySenseSettings) -> Mapping[str, float]:
    """Return the rates of the settings, by data name."""
    return {
        "ppg": own.ppg_rate_hz,
        "acc": own.acc_rate_hz,
        "gyro": own.gyro_rate_hz,
        "mag": own.mag_rate_hz,
    }


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], PolarDriver]:
    """Share emitter and choice of the device between all connections."""
    own = own_settings(PolarVeritySenseSettings, settings)
    emitter = OpticalEmitter(sink)
    choice = Choice(identify, "Polar optical sensor", own.device, _ADVICE)
    plan = Plan(
        lambda info: wanted_of(own, info),
        SdkMode(is_wanted=own.sdk_mode, log=emitter.log).prepare,
        farewell=[LEAVE] if own.sdk_mode else [],
        has_heart_rate=not own.sdk_mode,
    )

    pairing = Pairing(own.pair)

    def meet() -> PolarSession:
        return PolarSession(BleLink(choice, sink.clock, pairing=pairing), emitter, plan)

    return lambda: PolarDriver(meet, pairing, emitter, off_by(own), _asked_rates(own))


DRIVER = DriverEntry(PolarVeritySenseSettings, _make, recognise=recognise)
