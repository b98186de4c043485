"""Shimmer3 and Shimmer3R (LogAndStream firmware), over Bluetooth Classic."""

from biosensor_gateway.devices.sensor import Sensor
from biosensor_gateway.devices.shimmer3.declaration import SPEC

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.shimmer3.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.shimmer3.simulator:SimulatedExgUnit",
        "emg": "biosensor_gateway.devices.shimmer3.simulator:SimulatedEmgUnit",
        "imu": "biosensor_gateway.devices.shimmer3.simulator:SimulatedImuUnit",
        "3r": "biosensor_gateway.devices.shimmer3.simulator:SimulatedShimmer3R",
    },
    # Of a name that does not tell the board, one with skin conductance is meant.
    precedence=-1,
)
