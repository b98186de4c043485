"""Packets, for the speed of decoders."""

from benchmarks.tape import Taped

TAPED = Taped(
    decoder="biosensor_gateway.devices.vernier_respiration_belt.driver.protocol:VernierProtocol",
    methods=("feed",),
)
