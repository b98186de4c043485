"""A virtual Cortex service with one headset: JSON-RPC over a TLS WebSocket."""

from biosensor_gateway.devices.emotiv_insight.simulator.account import App, Licence
from biosensor_gateway.devices.emotiv_insight.simulator.cortex import Circumstances, SimulatedCortex
from biosensor_gateway.devices.emotiv_insight.simulator.headset import (
    INSIGHT_1,
    INSIGHT_1_GYRO,
    INSIGHT_2,
    Metrics,
    Model,
    Release,
    Timing,
)

__all__ = [
    "INSIGHT_1",
    "INSIGHT_1_GYRO",
    "INSIGHT_2",
    "App",
    "Circumstances",
    "Licence",
    "Metrics",
    "Model",
    "Release",
    "SimulatedCortex",
    "Timing",
]
