"""Zephyr BioHarness 3 over its Bluetooth serial port."""

from biosensor_gateway.devices.sensor import Sensor
from biosensor_gateway.devices.zephyr.declaration import SPEC

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.zephyr.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.zephyr.simulator:SimulatedZephyr",
        # Real bytes of a BioHarness 3 instead of a made-up signal; it starts over after 150 s.
        "recording": "biosensor_gateway.devices.zephyr.simulator:RecordedZephyr",
    },
    demo="recording",
)
