"""Results of searches and tests, for scripts by ``--json`` and for the page by its API."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field


class FoundDevice(BaseModel):
    """A device that a search found.

    Attributes
    ----------
    title
        What people call the kind of sensor.
    rssi_dbm
        How strong its signal is; None where there is none.
    settings, toml
        What its table in the settings needs, and the same as lines of the file.
    is_known
        Whether the settings have it already.
    """

    sensor: str
    title: str
    name: str
    rssi_dbm: int | None
    settings: dict[str, Any]
    toml: str
    is_known: bool


class SearchedPlace(BaseModel):
    """One kind of place that was searched.

    Attributes
    ----------
    problem
        Why the search was not possible, one sentence; None if it was.
    others
        What else is there, in words.
    advice
        How to tell devices apart that are called alike.
    """

    where: str
    problem: str | None = None
    others: list[str] = Field(default_factory=list[str])
    advice: list[str] = Field(default_factory=list[str])
    found: list[FoundDevice] = Field(default_factory=list[FoundDevice])


class StreamTestResult(BaseModel):
    """What one stream did in a test.

    Attributes
    ----------
    nominal_hz
        Declared; 0 for streams that come when they come.
    measured_hz
        By the samples' own times; None if it cannot be told.
    last
        Newest values, or text.
    """

    samples: int
    nominal_hz: float
    measured_hz: float | None
    last: list[float | str | None]


class DeviceTestResult(BaseModel):
    """What a device has shown in a test.

    Attributes
    ----------
    model, serial_number, firmware_version
        None if it never connected.
    problems
        One sentence each; empty if all is well.
    streams
        By data name.
    """

    connected: bool
    model: str | None
    serial_number: str | None
    firmware_version: str | None
    problems: list[str]
    streams: dict[str, StreamTestResult]
