"""Polar H10 chest strap over Bluetooth LE."""

from biosensor_gateway.devices.polar_h10.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.polar_h10.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.polar_h10.simulator:SimulatedPolarH10",
    },
    introduces=True,
)
