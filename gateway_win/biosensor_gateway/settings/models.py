"""Models of all settings; drivers add their fields in subclasses of `DeviceSettings`."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints
from pydantic.fields import FieldInfo
from pydantic_settings import (
    BaseSettings,
    EnvSettingsSource,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
)

from biosensor_common.lsl.api_file import DEFAULT_PORT_RANGE, LslOverrides
from biosensor_common.naming import MAX_LENGTH
from biosensor_common.spec import DeviceIdentity

USUAL_PORT = 17871
OF_NO_SITE = "null"
"""The origin that a browser sends for a page that was opened from a file."""

_MAX_ORIGINS = 20
_MAX_ORIGIN_LENGTH = 200
_NAME = r"(?:[a-z0-9_-]+\.)*[a-z0-9_-]+|\[[0-9a-f:.]+\]"
_ORIGIN = re.compile(rf"(?P<scheme>https?)://(?:{_NAME})(?P<port>:[1-9][0-9]{{0,4}})?")
_IMPLIED = {"http": ":80", "https": ":443"}


def _origin(value: str) -> str:
    """Return a valid origin; an invalid one would silently match no page."""
    if value == OF_NO_SITE:
        return value
    parts = _ORIGIN.fullmatch(value)
    if parts is None or len(value) > _MAX_ORIGIN_LENGTH:
        raise ValueError(
            "should be the origin of the experiment's page, in lower case and without a path, such "
            "as https://study.example.org or http://localhost:8080; or null for a page that is "
            "opened from a file"
        )
    if parts["port"] == _IMPLIED[parts["scheme"]]:
        raise ValueError(f"should not have {parts['port']}, which browsers leave out")
    return value


class Section(BaseModel):
    """A part of the settings file; unknown fields and other types are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class WebMarkerSettings(Section):
    """Which web pages may send markers."""

    origins: tuple[Annotated[str, AfterValidator(_origin)], ...] = Field(
        default=(),
        max_length=_MAX_ORIGINS,
        strict=False,
        examples=[["http://localhost:8080"]],
        description="Origins of the web experiments that may send markers, such as "
        "https://study.example.org; null is a page opened from a file, and also a page of "
        "any site that hides its origin. If the list is empty, nothing listens. They also "
        "need the token that this command shows: biosensor-gateway mark --web",
    )
    port: int = Field(
        default=USUAL_PORT,
        ge=1024,
        le=65535,
        description="Port on this computer on which the page's program listens for them.",
    )


OVERRIDE_PREFIX = "BIOSENSOR_GATEWAY_"
OVERRIDE_DELIMITER = "__"

_SESSION = re.compile(r"[A-Za-z0-9_.-]*")
_HOST = re.compile(r"[A-Za-z0-9_.:%-]+")


def _printable(value: str) -> str:
    if not value.isprintable() or value != value.strip():
        raise ValueError("should be printable text without spaces at its ends")
    return value


def _session(value: str) -> str:
    # The text goes into an LSL query and an INI file, which have no escapes.
    if not _SESSION.fullmatch(value):
        raise ValueError("should have only letters, digits, '_', '.' and '-'")
    return value


def _host(value: str) -> str:
    if not _HOST.fullmatch(value):
        raise ValueError("should be a host name or an IP address")
    return value


def _all_different(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"should not have the same name twice, but has {name!r}")
    return names


ShortText = Annotated[str, StringConstraints(max_length=MAX_LENGTH), AfterValidator(_printable)]
"""Printable text of at most 32 characters, for parts of stream names."""

# On macOS the address of a Bluetooth device is a UUID.
_MAX_UNIT_LENGTH = 36

UnitText = Annotated[
    str, StringConstraints(min_length=1, max_length=_MAX_UNIT_LENGTH), AfterValidator(_printable)
]
"""The same for a unit, up to 36 characters and not empty."""

_MAX_BUTTONS = 20

ButtonText = Annotated[
    str, StringConstraints(min_length=1, max_length=MAX_LENGTH), AfterValidator(_printable)
]
"""The same for a button, whose name cannot be empty."""


class LslSettings(Section):
    """How the agent takes part in the Lab Streaming Layer."""

    session_id: Annotated[str, AfterValidator(_session)] = Field(
        default="",
        description="LSL session that the streams belong to. Empty means LSL's default session; "
        "with any other, LabRecorder and every other LSL program sees nothing until it is "
        "set to the same session.",
    )
    known_peers: tuple[Annotated[str, AfterValidator(_host)], ...] = Field(
        default=(),
        strict=False,
        description="Host names or IP addresses to ask directly, for networks without multicast.",
    )
    port_range: int = Field(
        default=DEFAULT_PORT_RANGE,
        ge=1,
        le=32768,
        description="How many ports, from 16572, the streams of this computer may use; the "
        "firewall must allow them.",
    )

    @property
    def overrides(self) -> LslOverrides:
        """Overrides of the user's LSL file; the default port range overrides nothing."""
        port_range = self.port_range if "port_range" in self.model_fields_set else None
        return LslOverrides(self.session_id, self.known_peers, port_range)


class LogSettings(Section):
    """What is logged, and how much of it is kept."""

    level: Literal["debug", "info", "warning", "error"] = Field(
        default="info",
        description="Least severe messages to log: debug, info, warning or error.",
    )
    keep_files: int = Field(
        default=5, ge=1, le=1000, description="How many full log files are kept."
    )
    max_bytes: int = Field(
        default=5_000_000, ge=10_000, description="Size in bytes at which a log file is full."
    )


class EventSettings(Section):
    """Settings of the stream gateway/events."""

    heartbeat_s: float = Field(
        default=5.0,
        ge=0,
        le=3600,
        allow_inf_nan=False,
        description="Seconds between two heartbeats in the stream of events; 0 for none. A "
        "recording without any does not show the state of the devices.",
    )


class MarkerSettings(Section):
    """How the experimenter marks what happens in the stream gateway/markers."""

    buttons: Annotated[tuple[ButtonText, ...], AfterValidator(_all_different)] = Field(
        default=("baseline", "stimulus on", "stimulus off"),
        max_length=_MAX_BUTTONS,
        strict=False,
        description="Names of the markers that can be set with one press; the first nine have the "
        "keys 1 to 9, in this order. A change takes effect after: biosensor-gateway reload",
    )
    web: WebMarkerSettings = Field(
        default=WebMarkerSettings(), description="Markers that web experiments send."
    )


class PowerSettings(Section):
    """Settings about the power management of the agent's computer."""

    keep_awake: bool = Field(
        default=True,
        description="Whether to keep the computer from going to sleep automatically while a device "
        "streams, and for a minute after. The screen may go dark. Closing the lid still "
        "sends it to sleep, and so may a long time on battery: plug it in.",
    )


class DeviceSettings(Section):
    """Settings of every device; each driver adds its own fields in a subclass.

    A subclass uses only scalars, lists (``tuple`` with ``strict=False``) and
    ``Literal`` for choices. Every field has a description, and a required field
    has an example, which the template shows.
    """

    sensor: str = Field(description="Kind of sensor.")
    unit: UnitText = Field(
        description="Serial number or address of the device, or a short name that stays the same.",
        examples=["0123456789"],
    )
    participant: ShortText = Field(
        default="",
        description="Who wears the device: a pseudonym such as p01, never a real name, because it "
        "is in stream names, topics and recordings.",
    )
    label: ShortText = Field(
        default="",
        description="Distinguishes two devices of one kind on one person, for instance left and "
        "right.",
    )
    enabled: bool = Field(default=True, description="Whether the agent connects to the device.")

    @property
    def sensor_name(self) -> str:
        """Name of the sensor in streams and topics: its kind, unless the settings have a name."""
        return self.sensor

    @property
    def identity(self) -> DeviceIdentity:
        """Identity of the device, for streams, topics and logs."""
        return DeviceIdentity(self.sensor_name, self.unit, self.participant, self.label)


class _SectionOverrides(EnvSettingsSource):
    """Overrides of sections by environment variables; devices are only in the file."""

    def prepare_field_value(
        self, field_name: str, field: FieldInfo, value: object, value_is_complex: bool
    ) -> object:
        if field_name == "devices":
            return None
        return super().prepare_field_value(field_name, field, value, value_is_complex)

    def decode_complex_value(self, field_name: str, field: FieldInfo, value: object) -> object:
        # Invalid JSON stays text, so that the model refuses it with the name of the key.
        try:
            return super().decode_complex_value(field_name, field, value)
        except ValueError:
            return value


class GatewaySettings(BaseSettings):
    """All settings.

    Environment variables take precedence over arguments, for the sections
    only: ``BIOSENSOR_GATEWAY_LSL__SESSION_ID=lab2``; lists are written in JSON.
    """

    model_config = SettingsConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        env_prefix=OVERRIDE_PREFIX,
        env_nested_delimiter=OVERRIDE_DELIMITER,
    )

    lsl: LslSettings = LslSettings()
    log: LogSettings = LogSettings()
    power: PowerSettings = PowerSettings()
    events: EventSettings = EventSettings()
    markers: MarkerSettings = MarkerSettings()
    devices: tuple[DeviceSettings, ...] = Field(default=(), alias="device")

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Use only the environment and the arguments, in this order of precedence."""
        del env_settings, dotenv_settings, file_secret_settings
        return _SectionOverrides(settings_cls), init_settings


def environment_overrides() -> dict[str, Any]:
    """Return the environment's overrides by section and key, not validated."""
    return _SectionOverrides(GatewaySettings)()
