"""The settings of an optical sensor."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble_pairing import PAIR_DESCRIPTION, PairSetting


class PolarVeritySenseSettings(DeviceSettings):
    """Settings of one Verity Sense, OH1 or 360."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the sensor, as scan shows it, or the id printed on it (8 "
        "characters); empty takes the only one in range.",
        examples=["A1B2C3D4"],
    )
    sdk_mode: bool = Field(
        default=False,
        description="Switch the sensor's SDK mode on: more rates and ranges, but neither heart "
        "rate nor pulse intervals.",
    )
    ppi: bool = Field(
        default=True,
        description="Whether the sensor sends the intervals between pulse waves, the first after "
        "25 s. With them the heart rate comes every 5 s, without them every second.",
    )
    ppg: bool = Field(default=True, description="Whether the sensor sends its light signals.")
    ppg_rate_hz: int = Field(
        default=55,
        ge=1,
        le=1000,
        description="Samples of light per second; the next lower rate that the sensor offers is "
        "taken. In the SDK mode, a Verity Sense has 28, 44, 55, 135 and 176.",
    )
    acc: bool = Field(default=True, description="Whether the sensor sends its acceleration.")
    acc_rate_hz: int = Field(
        default=52,
        ge=1,
        le=1000,
        description="Samples of acceleration per second; the next lower rate that the sensor "
        "offers is taken. In the SDK mode, a Verity Sense has 26, 52, 104, 208 and 416.",
    )
    acc_range_g: Literal[2, 4, 8, 16] = Field(
        default=8,
        description="Largest acceleration that can be measured, in g; 8 outside the SDK mode.",
    )
    gyro: bool = Field(
        default=True,
        description="Whether the sensor sends how it turns; a Verity Sense can.",
    )
    gyro_rate_hz: int = Field(
        default=52,
        ge=1,
        le=1000,
        description="Samples of the gyroscope per second, as for acc_rate_hz.",
    )
    gyro_range_deg_s: Literal[250, 500, 1000, 2000] = Field(
        default=2000,
        description="Fastest turn that can be measured, in deg/s; 2000 outside the SDK mode.",
    )
    mag: bool = Field(
        default=True,
        description="Whether the sensor sends the magnetic field; a Verity Sense can.",
    )
    mag_rate_hz: Literal[10, 20, 50, 100] = Field(
        default=50, description="Samples of the magnetic field per second."
    )
    pair: PairSetting = Field(default="auto", description=PAIR_DESCRIPTION)
