"""Emotiv Insight by way of the Cortex service."""

from biosensor_gateway.devices.emotiv_insight.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    service="EMOTIV Launcher",
    driver="biosensor_gateway.devices.emotiv_insight.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.emotiv_insight.simulator:SimulatedCortex",
    },
)
