"""Any strap that offers the Bluetooth Heart Rate Service."""

from biosensor_gateway.devices.ble_heart_rate.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.ble_heart_rate.driver.driver:DRIVER",
    virtual={
        "": "biosensor_gateway.devices.ble_heart_rate.simulator:SimulatedHeartRateStrap",
    },
    precedence=-1,
)
