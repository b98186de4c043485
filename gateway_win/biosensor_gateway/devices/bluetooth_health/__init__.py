"""Any device with a standard Bluetooth service for health or sports."""

from biosensor_gateway.devices.bluetooth_health.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.bluetooth_health.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.bluetooth_health.simulator:SimulatedHealthDevice",
    },
    precedence=-1,
)
