"""The Polar products that can be simulated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from biosensor_gateway.devices.polar_h10.simulator.frames import (
    ACC_16_BIT,
    ACC_COMPRESSED_COUNTS,
)
from biosensor_gateway.devices.polar_h10.simulator.pmd import (
    Measurement,
    Offered,
    Setting,
    encode_factor,
)

_CHEST, _OTHER_LOCATION = 1, 0
_VERITY_G_PER_COUNT = 0.000244


@dataclass(frozen=True)
class Product:
    """What distinguishes one product from another.

    Attributes
    ----------
    advertised
        Its name on the air, before the device id.
    model, firmware
        As the Device Information service has them.
    body_location
        Value of 0x2A38.
    sends_rr
        Whether heart rate measurements carry R-R intervals.
    settings
        What can be measured, with the settings on offer in the order of the reply.
    start_parameters
        What the reply to a start carries behind its status.
    acc_format
        Format byte of acceleration frames.
    acc_unit_g
        What one count of acceleration is [g].
    minimum_mtu
        Nothing is started over a link with a smaller ATT MTU.
    has_sdk_mode
    """

    advertised: str
    model: str
    firmware: str
    body_location: int
    sends_rr: bool
    settings: Mapping[Measurement, Offered]
    start_parameters: Mapping[Measurement, bytes]
    acc_format: int
    acc_unit_g: float
    minimum_mtu: int = 0
    has_sdk_mode: bool = False

    @property
    def features(self) -> frozenset[Measurement]:
        """What the feature bits say."""
        sdk_mode = {Measurement.SDK_MODE} if self.has_sdk_mode else set[Measurement]()
        return frozenset(self.settings) | sdk_mode


H10 = Product(
    advertised="Polar H10",
    model="H10",
    firmware="3.3.1",
    body_location=_CHEST,
    sends_rr=True,
    settings={
        Measurement.ECG: {Setting.SAMPLE_RATE: (130,), Setting.RESOLUTION: (14,)},
        Measurement.ACC: {
            Setting.SAMPLE_RATE: (25, 50, 100, 200),
            Setting.RESOLUTION: (16,),
            Setting.RANGE: (2, 4, 8),
        },
    },
    # One reserved byte, which is no setting, as a real H10 sends it.
    start_parameters={Measurement.ACC: b"\1"},
    acc_format=ACC_16_BIT,
    acc_unit_g=1e-3,
)

VERITY_SENSE = Product(
    advertised="Polar Sense",
    model="Verity Sense",
    firmware="2.1.0",
    body_location=_OTHER_LOCATION,
    sends_rr=False,
    settings={
        Measurement.PPG: {
            Setting.SAMPLE_RATE: (55,),
            Setting.RESOLUTION: (22,),
            Setting.CHANNELS: (4,),
        },
        Measurement.ACC: {
            Setting.SAMPLE_RATE: (52,),
            Setting.RESOLUTION: (16,),
            Setting.RANGE: (8,),
            Setting.CHANNELS: (3,),
        },
        Measurement.PPI: {},
    },
    start_parameters={Measurement.ACC: encode_factor(_VERITY_G_PER_COUNT)},
    acc_format=ACC_COMPRESSED_COUNTS,
    acc_unit_g=_VERITY_G_PER_COUNT,
    # A reference sample of four channels fills a smaller packet.
    minimum_mtu=64,
    has_sdk_mode=True,
)
"""Without the gyroscope and the magnetometer of the real one."""
