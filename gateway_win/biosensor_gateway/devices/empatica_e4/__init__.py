"""Empatica E4 wristband, by way of the vendor's streaming server."""

from biosensor_gateway.devices.empatica_e4.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    service="E4 streaming server",
    driver="biosensor_gateway.devices.empatica_e4.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.empatica_e4.simulator:SimulatedE4",
    },
)
