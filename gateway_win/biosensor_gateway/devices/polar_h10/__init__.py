"""Polar H10 chest strap: a Bluetooth heart-rate strap with ECG and acceleration."""

from dataclasses import replace

from biosensor_common import plausible
from biosensor_common.quantities import ContentType, Unit
from biosensor_common.spec import SensorSpec
from biosensor_common.table import channels, hardware, raw
from biosensor_gateway.devices import ble_heart_rate
from biosensor_gateway.devices.sensor import Sensor

_STRAP = ble_heart_rate.SPEC

SPEC = SensorSpec(
    name="polar_h10",
    title="Polar H10",
    manufacturer="Polar Electro",
    model="H10",
    streams=(
        replace(_STRAP.stream("hr"), contract=True),
        _STRAP.stream("ibi"),
        raw("ecg", ContentType.ECG, channels(Unit.MICROVOLTS, "ECG",
            plausible=plausible.BIOPOTENTIAL_UV), 130, chunk="ecg"),
        hardware("acc", ContentType.ACCELEROMETER, channels(Unit.G, *"XYZ",
            plausible=plausible.ACCELERATION_G), 50),
        _STRAP.stream("bat"),
        _STRAP.stream("rssi"),
        _STRAP.stream("quality"),
    ),
)  # fmt: skip

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.polar_h10.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.polar_h10.simulator:SimulatedPolarH10",
    },
    introduces=True,
)
