"""Replays in the API; what a replay says of itself has the models of its process."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from biosensor_gateway.page.screen_models import ScreenStream
from biosensor_gateway.recording.replay.speeds import FASTEST, SLOWEST

LongText = Annotated[str, Field(max_length=1024)]


def _can_be_path(text: str) -> str:
    try:
        is_usable = "\0" not in str(Path(text).expanduser())
    except RuntimeError:
        # It names the home folder of somebody whom this computer does not know.
        is_usable = False
    if not is_usable:
        raise ValueError("nothing on this computer can be called so")
    return text


PathText = Annotated[LongText, AfterValidator(_can_be_path)]


class ReplayedStreamView(ScreenStream):
    """One stream that is played.

    Attributes
    ----------
    nominal_hz
        At the speed of the replay.
    is_empty
        Whether the recording has no sample of it.
    """

    nominal_hz: float
    is_empty: bool


class ReplayedDeviceView(BaseModel):
    """Streams of a recording that belong to one device, or to one name of another program.

    Attributes
    ----------
    title
        What people call the kind of sensor.
    battery_percent
        As it was then; None where nothing tells it.
    streams
        By source_id.
    """

    name: str
    title: str
    unit: str
    participant: str
    label: str
    battery_percent: float | None
    streams: dict[str, ReplayedStreamView]


class ReplayView(BaseModel):
    """The replay that was begun on this page.

    Attributes
    ----------
    is_running
        From the request on.
    is_playing
        Whether samples are sent, so that what receivers see is no person.
    file
        Without its folder.
    lap, position_s, length_s, sent, received, stream_count, said
        See `ReplayProgress`; the last ones stay when it has ended.
    """

    is_running: bool = False
    is_playing: bool = False
    file: str = ""
    speed: float = 1.0
    loop: bool = False
    lap: int = 0
    position_s: float = 0.0
    length_s: float = 0.0
    sent: int = 0
    received: int = 0
    stream_count: int = 0
    said: list[str] = Field(default_factory=list[str])
    devices: list[ReplayedDeviceView] = Field(default_factory=list[ReplayedDeviceView])


class RecordingFile(BaseModel):
    """A recording that can be played.

    Attributes
    ----------
    modified
        Unix time in s.
    """

    path: str
    name: str
    bytes: int
    modified: float


class RecordedStream(BaseModel):
    """A stream of a recording; `wearer` is empty if nobody is named."""

    name: str
    wearer: str
    samples: int


class RecordingContents(BaseModel):
    """What is in a recording.

    Attributes
    ----------
    length_s
        From the first sample to the last.
    problems
        What cannot be read, one sentence each.
    """

    length_s: float
    streams: list[RecordedStream]
    problems: list[str]


class RecordingPath(BaseModel):
    """Which recording."""

    model_config = ConfigDict(extra="forbid", strict=True)

    path: PathText


class NewReplay(RecordingPath):
    """What to play, and how; as the options of ``biosensor-gateway replay``."""

    speed: float = Field(default=1.0, ge=SLOWEST, le=FASTEST)
    begin: LongText = ""
    end: LongText = ""
    streams: list[LongText] = Field(default_factory=list[str], max_length=1024)
    loop: bool = False
    beside_live: bool = False
