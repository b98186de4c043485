"""Vernier Go Direct respiration belt (GDX-RB), over Bluetooth LE."""

from biosensor_gateway.devices.sensor import Sensor
from biosensor_gateway.devices.vernier_respiration_belt.declaration import SPEC

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.vernier_respiration_belt.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.vernier_respiration_belt.simulator:SimulatedBelt",
    },
    introduces=True,
)
