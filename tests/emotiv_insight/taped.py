"""Cortex's messages, for the speed of decoders."""

from benchmarks.tape import Taped

TAPED = Taped(
    functions=("biosensor_gateway.devices.emotiv_insight.driver.cortex:parse",),
    decoder="biosensor_gateway.devices.emotiv_insight.driver.protocol:Decoder",
    methods=("subscribed", "decode"),
)
