"""Lines of the server, for the speed of decoders."""

from benchmarks.tape import Taped

TAPED = Taped(
    decoder="biosensor_gateway.devices.empatica_e4.driver.protocol:E4Protocol",
    methods=("feed",),
)
