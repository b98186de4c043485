"""A virtual Cortex service with one headset: JSON-RPC over a TLS WebSocket."""

from biosensor_gateway.devices.emotiv_insight.simulator.account import App, Licence, User
from biosensor_gateway.devices.emotiv_insight.simulator.certificates import Leaf
from biosensor_gateway.devices.emotiv_insight.simulator.circumstances import Circumstances
from biosensor_gateway.devices.emotiv_insight.simulator.cortex import SimulatedCortex
from biosensor_gateway.devices.emotiv_insight.simulator.headset import Timing
from biosensor_gateway.devices.emotiv_insight.simulator.models import (
    EPOC_X,
    INSIGHT_1,
    INSIGHT_1_GYRO,
    INSIGHT_2,
    Model,
)
from biosensor_gateway.devices.emotiv_insight.simulator.release import Metrics, Release

__all__ = [
    "EPOC_X",
    "INSIGHT_1",
    "INSIGHT_1_GYRO",
    "INSIGHT_2",
    "App",
    "Circumstances",
    "Leaf",
    "Licence",
    "Metrics",
    "Model",
    "Release",
    "SimulatedCortex",
    "Timing",
    "User",
]
