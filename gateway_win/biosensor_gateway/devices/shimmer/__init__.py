"""Shimmer3 and Shimmer3R (LogAndStream firmware), over Bluetooth Classic."""

from biosensor_gateway.devices.sensor import Sensor
from biosensor_gateway.devices.shimmer.declaration import SPEC

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.shimmer.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.shimmer.simulator:SimulatedExgUnit",
        "emg": "biosensor_gateway.devices.shimmer.simulator:SimulatedEmgUnit",
        "imu": "biosensor_gateway.devices.shimmer.simulator:SimulatedImuUnit",
        "3r": "biosensor_gateway.devices.shimmer.simulator:SimulatedShimmer3R",
    },
    # Of a name that does not tell the board, one with skin conductance is meant.
    precedence=-1,
)
