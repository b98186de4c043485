"""Markers in the API."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class MarkerView(BaseModel):
    """One marker of the experimenter, or of a web experiment.

    Attributes
    ----------
    source
        Of a web experiment, where its page comes from.
    uncertainty_s
        By how many seconds its time may be wrong, where that was measured.
    received
        Whether any program received it.
    time
        Its Unix time in s, for people.
    earlier
        Whether it was before the recording that goes on, or that was the last here.
    can_be_undone
        Whether the agent that has sent it still runs, and it is of that recording.
    """

    id: int
    marker: str
    note: str
    kind: str
    source: str
    lsl_time: float
    undone: bool
    uncertainty_s: float | None = None
    received: bool = True
    time: float | None = None
    earlier: bool = False
    can_be_undone: bool = True


class MarkersView(BaseModel):
    """The newest markers, the newest last, and the names of the buttons.

    Attributes
    ----------
    told
        Whether an agent has said so; else there may be some.
    """

    told: bool = False
    markers: list[MarkerView] = Field(default_factory=list[MarkerView])
    buttons: list[str] = Field(default_factory=list[str])


class NewMarker(BaseModel):
    """A marker of the experimenter: a button, or a note."""

    model_config = ConfigDict(extra="forbid", strict=True)

    marker: str
    note: str = ""
    kind: Literal["button", "note"] = "button"


class MarkerButtons(BaseModel):
    """The names of the buttons, in their order."""

    model_config = ConfigDict(extra="forbid", strict=True)

    buttons: list[str]


class MarkerNumber(BaseModel):
    """Which marker; without a number the last that is not undone."""

    model_config = ConfigDict(extra="forbid", strict=True)

    id: int | None = None


class ExperimentView(BaseModel):
    """A page that is connected: its origin, and how well its clock is known, in seconds."""

    origin: str
    uncertainty_s: float | None = None


class ExperimentsView(BaseModel):
    """Where web experiments can mark, and which are there.

    Attributes
    ----------
    address
        Of the WebSocket's server; empty if nothing listens.
    problem
        Why nothing listens, though the settings name origins.
    foreign
        The origin that was refused last.
    """

    address: str = ""
    problem: str = ""
    origins: list[str] = Field(default_factory=list[str])
    connected: list[ExperimentView] = Field(default_factory=list[ExperimentView])
    foreign: str = ""
