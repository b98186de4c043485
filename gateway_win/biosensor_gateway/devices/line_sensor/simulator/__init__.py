"""Virtual boards that send lines, each by another way and in another format."""

from biosensor_gateway.devices.line_sensor.simulator.boards import (
    OpenEarableLineSensor,
    SimulatedLineSensor,
    StructLineSensor,
    UdpLineSensor,
    WebSocketLineSensor,
)

__all__ = [
    "OpenEarableLineSensor",
    "SimulatedLineSensor",
    "StructLineSensor",
    "UdpLineSensor",
    "WebSocketLineSensor",
]
