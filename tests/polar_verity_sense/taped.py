"""PMD frames, for the speed of decoders."""

from benchmarks.tape import Taped

TAPED = Taped(
    functions=("biosensor_gateway.devices.polar_h10.driver.emitter:parse_frame",),
)
