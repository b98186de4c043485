"""Any board that BrainFlow knows, read by BrainFlow itself where it is installed."""

from biosensor_gateway.devices.brainflow.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.brainflow.driver.driver:DRIVER",
    precedence=-1,
)
