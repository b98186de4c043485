"""Answers of the API `/api/v1`.

What the agent says of itself has the models of ``status --json``; here is what comes on top.
"""

from __future__ import annotations

from enum import StrEnum, unique
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, Field

from biosensor_gateway.agent.status import AgentFacts, DeviceFacts, StreamStatus
from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS
from biosensor_gateway.recording.xdf.findings import Finding


class ScreenStream(BaseModel):
    """What a screen shows of a stream, of whichever program.

    Attributes
    ----------
    source_id, lsl_name, topic
        Its names for programs, for LabRecorder, and in ROS with the usual prefix.
    measured_hz
        Over the last seconds, by the samples' own times; None while nothing comes, and for
        streams that come when they come.
    age_s
        Of the newest sample; None before the first.
    is_fresh
        Whether the newest values are those of now; a stale value is not shown.
    is_signal
        Whether it was measured on the body: not a battery, a radio or a counter.
    values
        Newest values by channel; empty when they are stale, and for text.
    """

    source_id: str
    data_name: str
    lsl_name: str
    topic: str
    content_type: str
    channels: list[str]
    units: list[str]
    measured_hz: float | None
    age_s: float | None
    is_fresh: bool
    is_signal: bool
    values: list[float | None]


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


class ExplainedFinding(BaseModel):
    """One thing that was found in a recording.

    Attributes
    ----------
    level
        ``error``, ``warning`` or ``note``.
    about
        ``persons``, ``others`` (streams of other programs) or ``ourselves``.
    means, to_do
        What it means for a study, and what to do; empty where nothing more is known.
    """

    level: str
    about: str
    text: str
    means: str
    to_do: str


def explained(finding: Finding) -> ExplainedFinding:
    """Return a finding with what it means for a study and what to do."""
    known = EXPLANATIONS.get(finding.code)
    return ExplainedFinding(
        level=finding.level.value,
        about=finding.about.value,
        text=f"{finding.stream}: {finding.text}" if finding.stream else finding.text,
        means=known.means if known else "",
        to_do=known.to_do if known else "",
    )


class VerdictView(BaseModel):
    """How good a recording is that was ended.

    Attributes
    ----------
    colour
        ``green``, ``amber`` or ``red``.
    findings
        Sentences, the worst first.
    explained
        The same by what they are about, with what each means and what to do.
    can_be_salvaged
        Whether it is cut or damaged, and samples can be read nevertheless.
    salvaged
        Where they were written to; empty before that.
    """

    colour: str
    sentence: str
    file: str
    findings: list[str]
    explained: list[ExplainedFinding] = []
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
