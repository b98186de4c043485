"""Packets, for the speed of decoders."""

from benchmarks.tape import Taped

TAPED = Taped(
    decoder="biosensor_gateway.devices.zephyr.driver.protocol:ZephyrProtocol",
    methods=("feed",),
)
