"""Shimmer3 GSR+ (LogAndStream firmware), over Bluetooth Classic."""

from biosensor_gateway.devices.sensor import Sensor
from biosensor_gateway.devices.shimmer3_gsr.declaration import SPEC

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.shimmer3_gsr.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.shimmer3_gsr.simulator:SimulatedShimmer3",
    },
    introduces=True,
)
