"""Models of the answers of the API `/api/v1`.

They extend the models of ``status --json`` in `biosensor_gateway.agent.status`.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum, unique
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from biosensor_gateway.agent.status import AgentFacts, DeviceFacts, StreamStatus
from biosensor_gateway.page.advice import clicked
from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS
from biosensor_gateway.recording.xdf.findings import Finding, by_event


class Body(BaseModel):
    """What a request contains; one with other fields or types is refused."""

    model_config = ConfigDict(extra="forbid", strict=True)


class ScreenStream(BaseModel):
    """A stream on the screen, of any program.

    Attributes
    ----------
    source_id, lsl_name, topic
        Its names for programs, in LabRecorder, and in ROS with the default prefix.
    measured_hz
        Rate over the last seconds, by the samples' stamps; None while no samples are received, and
        for irregular streams.
    age_s
        Of the newest sample; None before the first.
    is_fresh
        Whether the newest values are current; outdated values are not shown.
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
    """State of a stream or a device, as this computer sees it."""

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
    """Channels of a stream that are drawn together."""

    channels: list[str]
    units: list[str]
    values: list[float | None]


class SeenStreamView(ScreenStream):
    """One stream of the network.

    The base's `source_id` is a number by which the page asks for its traces, and `channels`,
    `units` and `values` are those of its first channels.
    """

    nominal_hz: float  # Nominal rate; 0 for irregular streams.
    lost: int | None  # Number of lost samples; None if unknown.
    seen: SeenState  # State of the stream.
    silent_s: float  # How long no samples were received, or how long the stream has been gone.
    note: str  # What is wrong with it; empty if nothing is.
    # Whether `lost` is estimated from the stamps, since the stream is received here.
    is_lost_estimated: bool
    is_text: bool
    texts: list[TextView]  # Its newest entries, the newest first.
    channel_count: int  # Number of all its channels.
    # Further channels that a browser shows, by the number of the first.
    windows: dict[int, WindowView]
    bytes_per_s: float  # Data rate by its nominal rate; 0 for an irregular stream.
    # For a feature: the `source_id` of its source stream if that is listed, else its LSL name;
    # empty for other streams.
    derived_from: str

    def outdated(self) -> SeenStreamView:
        """Return a copy without values and rate."""
        windows = {n: each.model_copy(update={"values": []}) for n, each in self.windows.items()}
        over: dict[str, object] = {"is_fresh": False, "values": [], "measured_hz": None}
        over["windows"] = windows
        return self.model_copy(update=over)


class SeenDeviceView(BaseModel):
    """One device of an agent, or the streams of another program with one name on one computer.

    Attributes
    ----------
    name
        Identifies it on the page.
    section
        Heading under which it is shown.
    replay
        The recording that is played; empty for live streams.
    is_ours
        Whether it is a device of one of our agents.
    worn
        None if unknown.
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
        Local LSL time of this view.
    searched_s
        How long the search for streams has lasted.
    search
        How streams are searched for, as help if none is found; one sentence each.
    inlets, most_inlets, not_received
        Number of streams that are received, the limit, and the number shown without being received.
    problems
        Streams that cannot be shown, and other problems; one sentence each.
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
        Origin of the page of a web experiment.
    uncertainty_s
        Uncertainty of its time in seconds, if it was measured.
    received
        Whether any program received it.
    time
        Its Unix time in s, for people.
    earlier
        Whether it was sent before the current or last recording began.
    can_be_undone
        Whether the agent that sent it still runs, and it belongs to that recording.
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
        Whether the markers were received from an agent; if not, there may be unknown ones.
    """

    told: bool = False
    markers: list[MarkerView] = Field(default_factory=list[MarkerView])
    buttons: list[str] = Field(default_factory=list[str])


class ExperimentView(BaseModel):
    """A connected page: its origin, and the uncertainty of its clock in seconds."""

    origin: str
    uncertainty_s: float | None = None


class ExperimentsView(BaseModel):
    """The server for web experiments, and the connected ones.

    Attributes
    ----------
    address
        Of the WebSocket's server; empty if it does not listen.
    problem
        Why it does not listen although the settings name origins.
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
        # The path has the home folder of an unknown user.
        is_usable = False
    if not is_usable:
        raise ValueError("nothing on this computer can have this name")
    return text


PathText = Annotated[LongText, AfterValidator(_can_be_path)]


class ReplayedStreamView(ScreenStream):
    """A replayed stream."""

    nominal_hz: float  # At the speed of the replay.
    is_empty: bool  # Whether the recording has no samples of it.


class ReplayedDeviceView(BaseModel):
    """Replayed streams of one device, or of one name of another program.

    Attributes
    ----------
    title
        Name of the kind of sensor for people.
    battery_percent
        As it was recorded; None if unknown.
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
    """The replay that was started on this page.

    Attributes
    ----------
    is_running
        True from the request on.
    is_playing
        Whether samples are sent, so that receivers do not see a live person.
    file
        Without its folder.
    lap, position_s, length_s, sent, received, stream_count, said
        See `ReplayProgress`; the last values stay after the end.
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
    """Whether an agent runs."""

    RUNNING = "running"
    STARTING = "starting"
    ABSENT = "absent"


class StreamView(StreamStatus, ScreenStream):
    """One stream of the agent: its status, and what a screen needs in addition."""


class DeviceView(DeviceFacts):
    """One device of the agent: its status, and what a screen needs in addition."""

    name: str  # Name in commands, `sensor/unit`.
    title: str  # Name of the kind of sensor for people.
    is_sending: bool  # Whether it sends now; if not, its values are outdated and not shown.
    # Lost samples of all its streams; None while it does not send, because more may be lost.
    lost: int | None
    streams: dict[str, StreamView]  # By source_id.
    # Live features of these streams on the network, of any program.
    features: list[SeenStreamView] = Field(default_factory=list[SeenStreamView])


class ExplainedFinding(BaseModel):
    """A finding about a recording, with an explanation.

    Attributes
    ----------
    level
        ``error``, ``warning`` or ``note``.
    about
        ``persons``, ``others`` (streams of other programs) or ``ourselves``.
    means, to_do
        What it means for a study, and what to do; empty without an explanation.
    consequences
        Findings about streams that this one explains.
    """

    level: str
    about: str
    text: str
    means: str
    to_do: str
    consequences: list[str] = []


def sentence(finding: Finding) -> str:
    """Return a finding as one sentence for people who click, with its stream."""
    return clicked(f"{finding.stream}: {finding.text}" if finding.stream else finding.text)


def all_explained(findings: Sequence[Finding]) -> list[ExplainedFinding]:
    """Return findings with their explanations, each with its consequences."""
    return [
        _explained(each).model_copy(update={"consequences": list(map(sentence, consequences))})
        for each, consequences in by_event(findings)
    ]


def _explained(finding: Finding) -> ExplainedFinding:
    known = EXPLANATIONS.get(finding.code)
    return ExplainedFinding(
        level=finding.level.value,
        about=finding.about.value,
        text=sentence(finding),
        means=clicked(known.means) if known else "",
        to_do=clicked(known.to_do) if known else "",
    )


class VerdictView(BaseModel):
    """Verdict on a recording that was ended.

    Attributes
    ----------
    colour
        ``green``, ``amber`` or ``red``.
    findings
        Sentences, the worst first.
    explained
        The same by what they are about, with what each means and what to do.
    can_be_salvaged
        Whether it is truncated or damaged, but some samples can be read.
    salvaged
        File with the salvaged samples; empty before that.
    """

    colour: str
    sentence: str
    file: str
    findings: list[str]
    explained: list[ExplainedFinding] = []
    can_be_salvaged: bool = False
    salvaged: str = ""


class RecordingView(BaseModel):
    """The recording of this computer.

    Attributes
    ----------
    busy
        ``starting`` or ``ending``; empty otherwise.
    folder
        Default folder of recordings.
    elapsed_s, bytes, streams
        Of the current recording.
    started
        Unix time in s at which the recording began; 0 without one.
    colour
        ``red`` if something is wrong; ``amber`` if something that could be recorded is not, or
        something has happened that matters for the analysis; else ``green``.
    problems
        Errors of the recording.
    notes
        Present or past deviations, such as a sensor that was away.
    remarks
        Other information, about which nothing is wrong.
    verdict
        Of the last recording, once it was ended on this page or, while the page looked on, by
        another program; None while one runs.
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
    """The view for other computers.

    Attributes
    ----------
    addresses
        One for each network of this computer, with the token.
    fingerprint
        SHA-256 of the certificate, about which a browser asks the first time.
    """

    addresses: list[str]
    fingerprint: str


class StatusView(AgentFacts):
    """The agent and its devices now."""

    agent: AgentState
    settings_file: str = ""
    problem: str = ""  # Problems of the settings, one per line; empty if there is none.
    configured: int = 0  # Number of devices in the settings.
    # Whether one person can wear all enabled devices, which then differ by sensor or label.
    one_wearer: bool = False
    skipped: int = 0  # Samples that this page was too slow to show; recordings have them.
    devices: list[DeviceView] = Field(default_factory=list[DeviceView])
    recording: RecordingView = Field(default_factory=RecordingView)
    markers: MarkersView = Field(default_factory=MarkersView)
    replay: ReplayView = Field(default_factory=ReplayView)
    share: ShareView | None = None  # None while the page is not shared with other computers.
    # None if the settings allow no web page to send markers.
    experiments: ExperimentsView | None = None


class Outcome(BaseModel):
    """Outcome of a request, in one sentence for people."""

    sentence: str


class Choice(BaseModel):
    """An answer to a question.

    Attributes
    ----------
    words
        Text of a button.
    more
        Fields to add to the same request.
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
