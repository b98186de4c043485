"""The settings of a headband."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from biosensor_gateway.settings.models import DeviceSettings

Preset = Literal[
    "",
    "p20",
    "p21",
    "p50",
    "p51",
    "p60",
    "p61",
    "p1034",
    "p1035",
    "p1041",
    "p1042",
    "p1043",
    "p1044",
    "p1045",
    "p1046",
]


class MuseSettings(DeviceSettings):
    """Settings of one Muse."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the headband, as scan shows it, or the four characters "
        "of its name, as in Muse-3A1F; empty takes the only one in range.",
        examples=["3A1F"],
    )
    aux: bool = Field(
        default=False,
        description="Whether the headband sends its inputs for electrodes of one's own: one of a "
        "Muse 2 or Muse S, four of an Athena.",
    )
    ppg: bool = Field(
        default=True, description="Whether a Muse 2 or Muse S sends its pulse light signals."
    )
    optics: Literal[0, 4, 8, 16] = Field(
        default=16,
        description="How many channels of light an Athena sends at least: those between the eyes, "
        "those of the whole forehead, or both with red and ambient light.",
    )
    preset: Preset = Field(
        default="",
        description="The headband's own number of what it sends, for one that the other settings "
        "do not lead to; empty chooses by them. Whatever it is, streams that are switched off "
        "are not sent.",
    )
