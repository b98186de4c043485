"""The file of a capture: compressed lines of JSON, a header and then events.

Captures come from strangers, so that the size is limited to `MAX_BYTES` and each line is validated.
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Mapping, Sequence
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.transports.ports import ASKING, CONTROL, DATA
from biosensor_gateway.transports.tap import CANCELLED, What

ENDING = ".capture.gz"
LICENCE = "CC0-1.0"
MAX_BYTES = 256 * 2**20
"""Limit of the uncompressed size: several hours of the busiest sensor."""

Text = Annotated[str, StringConstraints(max_length=500)]
Hex = Annotated[str, StringConstraints(pattern=r"^(?:[0-9a-f]{2})*$", max_length=2**23)]
Uuid = Annotated[str, StringConstraints(pattern=r"^[0-9a-f-]{0,36}$")]
Place = Annotated[
    str, StringConstraints(pattern=rf"^(?:[0-9a-f-]{{0,36}}|{ASKING}|{CONTROL}|{DATA})$")
]
"""A characteristic, or a port of a device that has several."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Advertised(_Part):
    """The advertisement of a Bluetooth LE device."""

    address: Text
    name: Text = ""
    rssi_dbm: int | None = None
    services: tuple[Uuid, ...] = ()
    manufacturer: Mapping[int, Hex] = Field(default_factory=dict[int, Hex])


class Row(_Part):
    """One characteristic of a GATT table."""

    uuid: Uuid
    service: Uuid
    properties: tuple[Text, ...]


class Event(_Part):
    """One event on a link."""

    t: float = Field(allow_inf_nan=False)  # Seconds since the first link was opened.
    link: int = Field(ge=0)  # Number of the connection, from 0.
    what: What
    at: Place = ""
    data: Hex = ""
    took: float = Field(default=0.0, ge=0, allow_inf_nan=False)  # How long an answer took [s].
    error: Text = ""
    seen: Advertised | None = None
    table: tuple[Row, ...] = ()

    @property
    def bytes(self) -> bytes:
        """The data as bytes."""
        return bytes.fromhex(self.data)

    @property
    def is_cancelled(self) -> bool:
        """Whether the driver did not wait for the answer."""
        return self.error == CANCELLED


class Arrivals(StrEnum):
    """Whether the times of a capture are those of arrival."""

    MEASURED = "measured"
    UNKNOWN = "not known"
    """They are the device's own, so that nothing can be said of stamps."""


class Header(_Part):
    """Description of a capture."""

    biosensor_capture: Literal[1] = 1
    sensor: Text
    manufacturer: Text = ""
    model: Text = ""
    firmware: Text = ""
    # Settings of the device that differ from the defaults.
    settings: Mapping[str, Any] = Field(default_factory=dict[str, Any])
    # Names of settings with free text, which may identify the owner or the place.
    left_out: tuple[Text, ...] = ()
    # system, radio: of the computer that recorded it.
    system: Text = ""
    radio: Text = ""
    gateway: Text = ""
    recorded: Text = ""  # Year and month.
    seconds: float = 0.0  # From the first event to the last.
    # How often a link could not be opened, by reason.
    failed: Mapping[str, int] = Field(default_factory=dict[str, int])
    licence: Text = LICENCE
    consent: Text = ""
    source: Text = ""  # Source of the bytes if another program recorded them; empty for this one.
    note: Text = ""  # Observations of the person who recorded it.
    arrivals: Arrivals = Arrivals.MEASURED


class Capture(_Part):
    """A header, and events in the order of their times."""

    header: Header
    events: tuple[Event, ...]

    def of_links(self) -> list[list[Event]]:
        """Return the events of each connection."""
        links: dict[int, list[Event]] = {}
        for event in self.events:
            links.setdefault(event.link, []).append(event)
        return list(links.values())


def packed(capture: Capture) -> bytes:
    """Return the content of a file; the same capture gives the same bytes."""
    lines = [_line(capture.header), *map(_line, capture.events)]
    return gzip.compress(("\n".join(lines) + "\n").encode(), mtime=0)


def _line(model: BaseModel) -> str:
    return json.dumps(model.model_dump(mode="json", exclude_defaults=True) | _marker(model))


def _marker(model: BaseModel) -> dict[str, int]:
    return {"biosensor_capture": 1} if isinstance(model, Header) else {}


def read(path: Path) -> Capture:
    """Read a file.

    Raises
    ------
    ConfigError
        ``NOT_FOUND``; ``UNREADABLE`` if the file is damaged or not a capture.
    """
    try:
        with gzip.open(path) as packed_file:
            content = packed_file.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise ConfigError(ConfigReason.NOT_FOUND, f"there is no file {path}") from error
    except (OSError, EOFError, zlib.error) as error:
        raise _unreadable(path, "it is not compressed by gzip, or is truncated") from error
    if len(content) > MAX_BYTES:
        raise _unreadable(path, f"it is larger than {MAX_BYTES >> 20} MB")
    return _parsed(path, content.splitlines())


def _parsed(path: Path, lines: Sequence[bytes]) -> Capture:
    events: list[Event] = []
    try:
        header = Header.model_validate_json(lines[0] if lines else b"")
        for line in lines[1:]:
            events.append(Event.model_validate_json(line))  # noqa: PERF401 - counted if one fails
    except ValidationError as error:
        what = f"line {len(events) + 1}, or the one after it: {error.errors()[0]['msg']}"
        raise _unreadable(path, what) from error
    for before, after in pairwise(events):
        if after.t < before.t:
            raise _unreadable(path, "its times step back")
    return Capture(header=header, events=tuple(events))


def _unreadable(path: Path, why: str) -> ConfigError:
    message = f"{path} is not a capture that can be read: {why}; have it sent again"
    return ConfigError(ConfigReason.UNREADABLE, message)
