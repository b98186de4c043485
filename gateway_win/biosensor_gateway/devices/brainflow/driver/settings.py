"""Settings of a board that BrainFlow reads."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from biosensor_common.naming import AGENT, NODE
from biosensor_common.spec import is_data_name
from biosensor_gateway.devices import registry
from biosensor_gateway.devices.brainflow.declaration import NAME
from biosensor_gateway.settings.models import DeviceSettings, ShortText

_BOARD = "_BOARD"


def _taken() -> set[str]:
    return {AGENT, NODE, *registry.sensor_names()} - {NAME}


def _name(value: str) -> str:
    if value and (not is_data_name(value) or value in _taken()):
        raise ValueError(
            "should be lower-case letters, digits and single _ , as in lab_cyton, and no other "
            "sensor's name"
        )
    return value


def _board(value: str) -> str:
    if not (value.isascii() and value.isupper() and is_data_name(value.lower())):
        raise ValueError("should be BrainFlow's name of the board, as in CYTON_BOARD")
    return value


class BrainFlowSettings(DeviceSettings):
    """Settings of one board."""

    board: Annotated[str, AfterValidator(_board)] = Field(
        description="BrainFlow's name of the board.", examples=["SYNTHETIC_BOARD"]
    )
    name: Annotated[ShortText, AfterValidator(_name)] = Field(
        default="",
        description="What topics call the board; empty is BrainFlow's name in lower case: "
        "CYTON_BOARD has /biosensors/cyton/...",
    )
    electrodes: Literal["", "eeg", "ecg", "emg", "eog"] = Field(
        default="",
        description="What the electrodes are on, because most boards do not know; empty is the "
        "first of eeg, ecg, emg and eog that the board can have.",
    )
    python: str = Field(
        default="",
        description="Full path of the Python that has BrainFlow. Empty is the one that this "
        "program runs in; the installed program has none and needs it.",
    )
    serial_port: str = Field(
        default="", description="Of boards with a dongle or cable, as in COM3 or /dev/ttyUSB0."
    )
    mac_address: str = Field(default="", description="Of Bluetooth boards that need it.")
    serial_number: str = Field(
        default="", description="Of the device, or its Bluetooth name, where a board needs it."
    )
    ip_address: str = Field(default="", description="Of boards on the network.")
    ip_port: int = Field(default=0, ge=0, le=65535, description="Of boards on the network.")
    timeout_s: int = Field(
        default=0, ge=0, le=600, description="How long BrainFlow looks for it; 0 is its own choice."
    )
    other_info: str = Field(
        default="", description="What BrainFlow's page on the board calls other_info."
    )
    file: str = Field(
        default="", description="Recording of PLAYBACK_FILE_BOARD, which is played in its place."
    )
    master_board: str = Field(
        default="", description="The board that recorded it, as in CYTON_BOARD."
    )
    config: tuple[str, ...] = Field(
        default=(),
        strict=False,
        max_length=64,
        description="Texts that the board is configured with before it starts, in this order.",
    )
    rate_hz: float = Field(
        default=0.0,
        ge=0,
        le=100_000,
        allow_inf_nan=False,
        description="Samples a second, where config makes them others than BrainFlow says; 0 is "
        "what BrainFlow says.",
    )

    @property
    def sensor_name(self) -> str:
        """What streams and topics call it."""
        if self.name:
            return self.name
        slug = self.board.removesuffix(_BOARD).lower()
        return f"{NAME}_{slug}" if slug in _taken() else slug

    @property
    def parameters(self) -> dict[str, str | int]:
        """The fields of BrainFlow's input parameters that are set."""
        fields: dict[str, str | int] = {
            "serial_port": self.serial_port,
            "mac_address": self.mac_address,
            "serial_number": self.serial_number,
            "ip_address": self.ip_address,
            "ip_port": self.ip_port,
            "timeout": self.timeout_s,
            "other_info": self.other_info,
            "file": self.file,
            "master_board": self.master_board,
        }
        return {name: value for name, value in fields.items() if value}
