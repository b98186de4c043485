"""Packets and replies, for the speed of decoders."""

from benchmarks.tape import Taped

TAPED = Taped(
    decoder="biosensor_gateway.devices.shimmer.driver.protocol:ShimmerProtocol",
    methods=("feed", "settle", "give_up", "expect_data"),
    attributes=("crc", "form"),
)
