"""The agent and its devices now: what its status file, ``status --json`` and the page's API say.

One set of models for all three. The agent fills them once a second; the page adds to them what a
screen needs, by classes that inherit from these.
"""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import BaseModel, Field

from biosensor_common.refusals import Refusals
from biosensor_common.spec import FromDevice, StreamSpec
from biosensor_gateway.devices.registry import declaration


class ClockStatus(BaseModel):
    """How a device's clock is mapped to the LSL clock; see `biosensor_common.device_clock`.

    Attributes
    ----------
    offset_s
        LSL time minus device time at the newest device time, in seconds; it contains the
        smallest delay of the way.
    drift_ppm
        LSL microseconds gained per device second: positive for a slow device clock.
    residual_rms_s
        RMS distance in seconds of the earliest packets of each half second from the line that
        is kept below them.
    reanchors
        How often the mapping had to jump.
    observations
        Packets that it was measured by.
    newest_s
        LSL time of the newest device time, in seconds.
    """

    offset_s: float
    drift_ppm: float
    residual_rms_s: float
    reanchors: int
    observations: int
    newest_s: float


class RefusedStatus(BaseModel):
    """Something that was not passed on as it came; see `biosensor_common.refusals`.

    Attributes
    ----------
    what
        A word of `biosensor_common.refusal.Refusal`.
    about
        Which stream it is of, if that is not where it stands.
    level
        ``warn`` or ``error``.
    sentence
        For a person.
    count
        In all.
    first_s, last_s
        LSL time in seconds.
    now
        Whether it lasts, or was within the last seconds.
    """

    what: str
    about: str = ""
    level: str
    sentence: str
    count: int
    first_s: float
    last_s: float
    now: bool

    @classmethod
    def of(cls, refusals: Refusals) -> list[RefusedStatus]:
        """Describe everything that was reported, what is worst and now first."""
        present = refusals.present
        others = [each for each in refusals.all if each not in present]
        return [
            cls(
                what=each.what.word,
                about=each.about,
                level=each.what.level.name.lower(),
                sentence=each.sentence_about,
                count=each.count,
                first_s=each.first_s,
                last_s=each.last_s,
                now=each in present,
            )
            for each in (*present, *others)
        ]


class StreamStatus(BaseModel):
    """What happened to one stream's samples on their way into LSL.

    Attributes
    ----------
    pushed, lost, refused, withheld, waited, last_stamp
        See `biosensor_gateway.streaming.counters.Counters`.
    nominal_hz
        Declared rate, 0 for streams that come when they come.
    silent
        Whether the settings switch it off, or this model has it only in name.
    refusals
        What was not passed on as it came.
    """

    pushed: int
    lost: int
    refused: int
    last_stamp: float
    withheld: int
    waited: int
    nominal_hz: float
    silent: bool
    refusals: list[RefusedStatus] = Field(default_factory=list[RefusedStatus])


class DeclaredStream(BaseModel):
    """A stream as it is declared, for who knows the agent by its status alone.

    Attributes
    ----------
    nominal_hz
        0 for streams that come when they come, None where the device says it.
    is_text
        Whether its samples are strings.
    labels, units
        Of its channels.
    """

    data_name: str
    content_type: str
    nominal_hz: float | None
    is_text: bool
    labels: list[str]
    units: list[str]

    @classmethod
    def of(cls, stream: StreamSpec) -> DeclaredStream:
        """Describe a stream of a declaration."""
        return cls(
            data_name=stream.data_name,
            content_type=stream.content_type.value,
            nominal_hz=None if isinstance(stream.rate, FromDevice) else stream.rate,
            is_text=stream.message_type.is_text,
            labels=list(stream.labels),
            units=[str(channel.unit) for channel in stream.channels],
        )


class DeviceFacts(BaseModel):
    """One device, without its streams.

    Attributes
    ----------
    sensor, unit, participant, label
        Which device it is, and who wears it.
    state
        Where it is on its way to streaming, a value of `biosensor_gateway.agent.state.State`.
    paused
        Whether its participant has withdrawn, so that nothing is sent.
    since
        Unix time in seconds since when it is paused or does not stream; None while it streams.
    worn
        None where nobody knows.
    connections
        How often it was connected.
    error
        Why it does not stream, in one sentence; None while all is well.
    dropped_bytes
        Bytes that made no valid message.
    battery_percent
        None where nobody knows, and while the device is not connected.
    clock
        None before its first packet.
    refusals
        What came of it and is no sample of any stream.
    """

    sensor: str
    unit: str
    participant: str
    label: str
    state: str
    paused: bool
    worn: bool | None
    connections: int
    error: str | None
    dropped_bytes: int
    battery_percent: float | None
    clock: ClockStatus | None
    since: float | None = None
    refusals: list[RefusedStatus] = Field(default_factory=list[RefusedStatus])


class DeviceStatus(DeviceFacts):
    """One device.

    Attributes
    ----------
    streams
        By source_id.
    declared
        What the device's settings declare; empty where its sensor's declaration says it all.
    """

    streams: dict[str, StreamStatus]
    declared: list[DeclaredStream] = Field(default_factory=list[DeclaredStream])


class AgentFacts(BaseModel):
    """An agent, without its devices; as they stand here while there is none.

    Attributes
    ----------
    written
        When this was so, Unix time in seconds.
    lsl_time
        The same as LSL time, on which the clocks' `newest_s` and the streams' `last_stamp` are.
    process
        Its number.
    virtual
        Whether its devices are virtual.
    restarts, last_end
        How often the agent died and came back, and how it ended last.
    refusals
        What of the agent's own streams is not sent, or not received.
    """

    written: float | None = None
    lsl_time: float | None = None
    process: int | None = None
    virtual: bool = False
    restarts: int = 0
    last_end: str = ""
    refusals: list[RefusedStatus] = Field(default_factory=list[RefusedStatus])


class AgentStatus(AgentFacts):
    """An agent with its devices."""

    devices: list[DeviceStatus] = Field(default_factory=list[DeviceStatus])


def declared_streams(sensor: str, own: Sequence[DeclaredStream] = ()) -> tuple[DeclaredStream, ...]:
    """Return the streams of a device.

    Parameters
    ----------
    sensor
        As its identity has it.
    own
        What the status says that its settings declare.

    Raises
    ------
    SpecError
        If it declares nothing itself, and its sensor's declaration cannot be loaded.
    """
    if own:
        return tuple(own)
    return tuple(DeclaredStream.of(each) for each in declaration(sensor).streams)
