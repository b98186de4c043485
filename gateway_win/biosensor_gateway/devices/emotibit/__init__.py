"""EmotiBit, over Wi-Fi."""

from biosensor_gateway.devices.emotibit.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.emotibit.driver.driver:DRIVER",
    virtual={"": "biosensor_gateway.devices.emotibit.simulator:SimulatedEmotiBit"},
)
