"""Heart rates, for the speed of decoders."""

from benchmarks.tape import Taped

TAPED = Taped(
    functions=("biosensor_gateway.devices.ble_heart_rate.driver.emitter:parse_measurement",),
)
