"""Polar's optical heart-rate sensors over Bluetooth LE: Verity Sense, OH1 and 360."""

from biosensor_gateway.devices.polar_verity_sense.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.polar_verity_sense.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.polar_verity_sense.simulator:SimulatedPolarVeritySense",
    },
)
