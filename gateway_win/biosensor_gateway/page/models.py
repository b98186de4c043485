"""Answers of the API `/api/v1`.

What the agent says of itself has the models of ``status --json``; here is what comes on top.
"""

from __future__ import annotations

from enum import StrEnum, unique

from pydantic import BaseModel, ConfigDict, Field

from biosensor_gateway.agent.status import AgentFacts, DeviceFacts, StreamStatus
from biosensor_gateway.doctor.scan import SearchedPlace
from biosensor_gateway.page.marker_models import ExperimentsView, MarkersView
from biosensor_gateway.page.network.models import SeenStreamView
from biosensor_gateway.page.replay_models import PathText, ReplayView
from biosensor_gateway.page.screen_models import ScreenStream
from biosensor_gateway.settings.models import ShortText, UnitText


@unique
class AgentState(StrEnum):
    """Whether there is an agent."""

    RUNNING = "running"
    STARTING = "starting"
    ABSENT = "absent"


class StreamView(StreamStatus, ScreenStream):
    """One stream of the agent: what it says of it, and what a screen needs besides."""


class DeviceView(DeviceFacts):
    """One device of the agent: what it says of it, and what a screen needs besides.

    Attributes
    ----------
    name
        What commands call it, ``sensor/unit``.
    title
        What people call the kind of sensor.
    is_sending
        Whether it sends now; if not, nothing that it told is of now, and nothing is shown of it.
    lost
        Samples of all its streams; None while it does not send, so that more may be lost.
    streams
        By source_id.
    features
        Live features of these streams that are on the network, whoever computes them.
    """

    name: str
    title: str
    is_sending: bool
    lost: int | None
    streams: dict[str, StreamView]
    features: list[SeenStreamView] = Field(default_factory=list[SeenStreamView])


class VerdictView(BaseModel):
    """How good a recording is that was ended.

    Attributes
    ----------
    colour
        ``green``, ``amber`` or ``red``.
    findings
        Sentences, the worst first.
    can_be_salvaged
        Whether it is cut or damaged, and samples can be read nevertheless.
    salvaged
        Where they were written to; empty before that.
    """

    colour: str
    sentence: str
    file: str
    findings: list[str]
    can_be_salvaged: bool = False
    salvaged: str = ""


class RecordingView(BaseModel):
    """The recording that is made here.

    Attributes
    ----------
    busy
        What is being done just now, ``starting`` or ``ending``; empty otherwise.
    folder
        Where recordings go if nothing else is said.
    elapsed_s, bytes, streams
        Of the recording that goes on.
    started
        Unix time in s at which the recording began; 0 without one.
    colour
        ``red`` if something is wrong, ``amber`` if not all is recorded that could be, or something
        has happened that its analysis must know; else ``green``.
    problems
        What is wrong with it.
    notes
        What is not as it should be, or was not for a while.
    remarks
        What else is good to know of it.
    verdict
        Of the last one that was ended on this page.
    """

    is_running: bool = False
    busy: str = ""
    folder: str = ""
    file: str = ""
    elapsed_s: float = 0.0
    started: float = 0.0
    bytes: int = 0
    streams: int = 0
    colour: str = "green"
    problems: list[str] = Field(default_factory=list[str])
    notes: list[str] = Field(default_factory=list[str])
    remarks: list[str] = Field(default_factory=list[str])
    verdict: VerdictView | None = None


class ShareView(BaseModel):
    """How other computers look on.

    Attributes
    ----------
    addresses
        One for each network of this computer, with the token.
    fingerprint
        SHA-256 of the certificate, which a browser asks about the first time.
    """

    addresses: list[str]
    fingerprint: str


class StatusView(AgentFacts):
    """The agent and its devices now.

    Attributes
    ----------
    problem
        What is wrong with the settings, one sentence for each line; empty if nothing is.
    configured
        How many devices the settings name.
    one_wearer
        Whether one person can wear all that are enabled, and be told apart by sensor and label.
    skipped
        Samples that this page was too slow to show; nothing of a recording.
    share
        None while no other computer can look on.
    experiments
        None if no web page may mark.
    """

    agent: AgentState
    settings_file: str = ""
    problem: str = ""
    configured: int = 0
    one_wearer: bool = False
    skipped: int = 0
    devices: list[DeviceView] = Field(default_factory=list[DeviceView])
    recording: RecordingView = Field(default_factory=RecordingView)
    markers: MarkersView = Field(default_factory=MarkersView)
    replay: ReplayView = Field(default_factory=ReplayView)
    share: ShareView | None = None
    experiments: ExperimentsView | None = None


class SearchView(BaseModel):
    """How a search goes on; what it finds is that of ``scan --json``."""

    running: bool = False
    seconds: float = 0.0
    elapsed_s: float = 0.0
    places: list[SearchedPlace] = Field(default_factory=list[SearchedPlace])
    done: bool = False


class SettingsChange(BaseModel):
    """A change of the settings.

    Attributes
    ----------
    while_recording
        Whether it is wanted although a recording goes on.
    """

    model_config = ConfigDict(extra="forbid", strict=True)

    while_recording: bool = False


class NewDevice(SettingsChange):
    """A device to add to the settings."""

    sensor: str
    settings: dict[str, str | int | float | bool]
    participant: ShortText = ""
    label: ShortText = ""


class DeviceName(BaseModel):
    """Which device."""

    model_config = ConfigDict(extra="forbid", strict=True)

    sensor: str
    unit: UnitText


class DeviceRemoval(SettingsChange, DeviceName):
    """Which device to take out of the settings."""


class DeviceChange(SettingsChange, DeviceName):
    """What a device of the settings is to have; None leaves it as it is."""

    participant: ShortText | None = None
    label: ShortText | None = None
    enabled: bool | None = None


class ParticipantNow(SettingsChange):
    """Who is to wear all sensors of the settings."""

    participant: str


class NewRecording(BaseModel):
    """What a recording is to be called, in the words of BIDS, and where it goes.

    Attributes
    ----------
    folder
        Empty for the usual one.
    only_ours
        Leave out streams of other programs, live features included.
    allow_missing
        Record although streams of the agent's devices are not there.
    set_sensors
        Have the participant wear all sensors first.
    other_participants
        Record although others than the participant wear the sensors.
    without_away
        Record although sensors are paused or do not stream.
    """

    model_config = ConfigDict(extra="forbid", strict=True)

    participant: str
    session: str = "S001"
    task: str = "Default"
    folder: PathText = ""
    only_ours: bool = False
    allow_missing: bool = False
    set_sensors: bool = False
    other_participants: bool = False
    without_away: bool = False


class Outcome(BaseModel):
    """What came of a request, in one sentence for people."""

    sentence: str


class Choice(BaseModel):
    """An answer to a question.

    Attributes
    ----------
    words
        For a button.
    more
        What the same request has then besides.
    """

    words: str
    more: dict[str, bool]


class Problem(BaseModel):
    """Why a request was refused, in one sentence: what, where, what to do.

    Attributes
    ----------
    title, choices
        Of a question; empty if nothing can be chosen.
    """

    problem: str
    title: str = ""
    choices: list[Choice] = Field(default_factory=list[Choice])
