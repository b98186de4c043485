"""Answers of the page of the network; see `biosensor_gateway.page.models`."""

from __future__ import annotations

from enum import StrEnum, unique

from pydantic import BaseModel, Field

from biosensor_gateway.page.screen_models import ScreenStream


@unique
class SeenState(StrEnum):
    """How a stream or a device does, as this computer sees it."""

    READING = "reading"
    LISTED = "listed"
    OPENING = "opening"
    STREAMING = "streaming"
    WAITING = "waiting"
    SILENT = "silent"
    GONE = "gone"


class TextView(BaseModel):
    """One entry of a stream of text."""

    text: str
    age_s: float


class WindowView(BaseModel):
    """Some channels of a stream that are drawn together."""

    channels: list[str]
    units: list[str]
    values: list[float | None]


class SeenStreamView(ScreenStream):
    """One stream of the network.

    The base's `source_id` is a number by which the page asks for its traces, and `channels`,
    `units` and `values` are those of its first channels.

    Attributes
    ----------
    nominal_hz
        Declared; 0 for streams that come when they come.
    lost
        None where nobody counts.
    seen
        How it does.
    silent_s
        How long nothing came, or how long it has been gone.
    note
        What is wrong with it; empty if nothing is.
    is_lost_estimated
        Whether `lost` is what the stamps show, and only since it is received.
    texts
        Its newest entries, the newest first.
    channel_count
        Of all its channels.
    windows
        Further channels that somebody looks at, by the number of the first.
    derived_from
        Of a feature: the `source_id` of the stream that it was computed of if that is listed, else
        what LSL calls that; empty if it is none.
    bytes_per_s
        What receiving it costs by its nominal rate; 0 if that is irregular.
    """

    nominal_hz: float
    lost: int | None
    seen: SeenState
    silent_s: float
    note: str
    is_lost_estimated: bool
    is_text: bool
    texts: list[TextView]
    channel_count: int
    windows: dict[int, WindowView]
    bytes_per_s: float
    derived_from: str

    def outdated(self) -> SeenStreamView:
        """Return the same without what is not of now."""
        windows = {n: each.model_copy(update={"values": []}) for n, each in self.windows.items()}
        over: dict[str, object] = {"is_fresh": False, "values": [], "measured_hz": None}
        over["windows"] = windows
        return self.model_copy(update=over)


class SeenDeviceView(BaseModel):
    """One device of an agent, or what another program calls by one name on one computer.

    Attributes
    ----------
    name
        By which the page knows it.
    section
        Below which heading it stands.
    replay
        The recording that is played; empty if it is measured now.
    is_ours
        Whether an agent of ours says so.
    worn
        None where nobody knows.
    """

    name: str
    title: str
    unit: str
    label: str
    participant: str
    host: str
    section: str
    replay: str
    is_ours: bool
    seen: SeenState
    silent_s: float
    worn: bool | None
    battery_percent: float | None
    lost: int | None
    is_lost_estimated: bool
    streams: list[SeenStreamView]


class NetworkView(BaseModel):
    """All streams that this computer sees.

    Attributes
    ----------
    made_s
        Local LSL time at which this was so.
    searched_s
        For how long it has looked.
    search
        How it looks for streams, for whoever finds none; one sentence each.
    inlets, most_inlets, not_received
        How many streams are received now, how many at most, and how many are shown without.
    problems
        Streams that cannot be shown, and what else is wrong; one sentence each.
    """

    made_s: float = 0.0
    searched_s: float = 0.0
    search: list[str] = Field(default_factory=list[str])
    inlets: int = 0
    most_inlets: int = 0
    not_received: int = 0
    problems: list[str] = Field(default_factory=list[str])
    devices: list[SeenDeviceView] = Field(default_factory=list[SeenDeviceView])
