"""Settings of one headset behind Cortex."""

from __future__ import annotations

from ipaddress import ip_address
from urllib.parse import urlsplit

from pydantic import Field, ValidationInfo, field_validator

from biosensor_gateway.settings.models import DeviceSettings

DEFAULT_URL = "wss://localhost:6868"


class EmotivInsightSettings(DeviceSettings):
    """Settings of one Insight.

    The client id and secret of the Cortex app are no settings: they come from the
    environment or the keyring.
    """

    headset: str = Field(
        default="",
        description="Id of the headset as EMOTIV Launcher shows it, INSIGHT-A1B2C3D4 for instance; "
        "* stands for any characters. Empty for the only one in reach.",
    )
    allow_remote: bool = Field(
        default=False,
        description="Whether Cortex may run on another computer, which then gets the client id and "
        "secret.",
    )
    url: str = Field(
        default=DEFAULT_URL,
        description="Where the Cortex service listens. Its certificate is for localhost, not for "
        "127.0.0.1.",
    )
    ca_file: str = Field(
        default="",
        description="PEM file of the vendor's root certificate. Empty for what the operating "
        "system trusts, which on Windows has it from the installer.",
    )
    license: str = Field(
        default="",
        description="Id of the Emotiv licence to use. Empty for the one that Cortex chooses.",
    )
    debit: int = Field(
        default=10,
        ge=0,
        description="How many sessions to draw from a counted licence at a time.",
    )

    @field_validator("url")
    @classmethod
    def _check_url(cls, url: str, info: ValidationInfo) -> str:
        parts = urlsplit(url)
        if parts.scheme != "wss" or not parts.hostname or parts.username is not None:
            raise ValueError(f"should be like {DEFAULT_URL}")
        if not (info.data.get("allow_remote") or is_loopback(parts.hostname)):
            raise ValueError("should be this computer, unless allow_remote is true")
        return url


def is_loopback(host: str) -> bool:
    """Tell whether a host name or address can only mean this computer."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
