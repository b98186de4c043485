"""Whatever sends lines of numbers, or records of bytes, that its settings describe."""

from biosensor_gateway.devices.line_sensor.declaration import SPEC
from biosensor_gateway.devices.sensor import Sensor

_SIMULATOR = "biosensor_gateway.devices.line_sensor.simulator"

SENSOR = Sensor(
    SPEC,
    driver="biosensor_gateway.devices.line_sensor.driver.driver:DRIVER",
    virtual={
        "": f"{_SIMULATOR}:SimulatedLineSensor",
        "udp": f"{_SIMULATOR}:UdpLineSensor",
    },
    precedence=-1,
)
