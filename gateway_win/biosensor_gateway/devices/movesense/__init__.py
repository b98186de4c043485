"""Movesense sensors over Bluetooth LE, by the GATT SensorData Protocol."""

from biosensor_gateway.devices.movesense.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.movesense.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.movesense.simulator:SimulatedMovesense",
    },
)
