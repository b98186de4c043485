"""A made-up belt on a serial port, as somebody would write it who adds a sensor."""

from biosensor_gateway.devices.sensor import Sensor

from .declaration import SPEC

SENSOR = Sensor(
    SPEC,
    driver=f"{__name__}.driver:DRIVER",
    virtual={"": f"{__name__}.simulator:SimulatedAcmeBand"},
)
