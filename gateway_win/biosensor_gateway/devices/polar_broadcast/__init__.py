"""Polar straps and watches whose heart rate is in their advertisements, without a connection."""

from biosensor_gateway.devices.polar_broadcast.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.polar_broadcast.driver.driver:DRIVER",
    virtual={"": "biosensor_gateway.devices.polar_broadcast.simulator:SimulatedPolarBroadcast"},
    # A connection gives more, where there is one.
    precedence=-2,
)
