"""Muse headbands over Bluetooth LE: Muse 2, Muse S and Muse S Athena."""

from biosensor_gateway.devices.muse.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.muse.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.muse.simulator:SimulatedMuse",
        "athena": "biosensor_gateway.devices.muse.simulator:SimulatedAthena",
    },
)
