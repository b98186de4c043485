"""Models of the status of an agent and its devices.

The status file, ``status --json`` and the page's API share them. The agent fills them once a
second; the page's subclasses add what a screen needs.
"""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import BaseModel, Field

from biosensor_common.refusal import Refusals
from biosensor_common.spec import FromDevice, StreamSpec
from biosensor_gateway.devices.registry import declaration


class ClockStatus(BaseModel):
    """How a device's clock is mapped to the LSL clock; see `biosensor_common.device_clock`."""

    # LSL time minus device time at the newest device time, in seconds; it contains the shortest
    # transmission delay.
    offset_s: float
    drift_ppm: float  # LSL microseconds gained per device second: positive for a slow device clock.
    # RMS distance in seconds of the earliest packet of each half second from the lower envelope.
    residual_rms_s: float
    reanchors: int  # How often the mapping was restarted after a clock step.
    observations: int  # Number of packets that the mapping is computed from.
    newest_s: float  # LSL time of the newest device time, in seconds.


class RefusedStatus(BaseModel):
    """Something that was not passed on unchanged; see `biosensor_common.refusal`."""

    what: str  # A word of `biosensor_common.refusal.Refusal`.
    about: str = ""  # LSL name of its stream, unless it is in the status of that stream.
    level: str  # `warn` or `error`.
    sentence: str  # For people.
    count: int
    # first_s, last_s: LSL time in seconds.
    first_s: float
    last_s: float
    now: bool  # Whether it still happens, or happened within the last seconds.

    @classmethod
    def of(cls, refusals: Refusals) -> list[RefusedStatus]:
        """Return all refusals; current ones first, the worst of them at the top."""
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
    """Counters of one stream's samples on their way into LSL.

    Attributes
    ----------
    pushed, lost, refused, withheld, waited, last_stamp
        See `biosensor_gateway.streaming.counters.Counters`.
    nominal_hz
        Nominal rate; 0 for irregular streams.
    silent
        Whether the settings switch the stream off, or this model of the device lacks it.
    refusals
        What was not passed on unchanged.
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
    """A declared stream, for programs that read only the agent's status."""

    data_name: str
    content_type: str
    # 0 for irregular streams; None if the device reports it when it connects.
    nominal_hz: float | None
    is_text: bool  # Whether its samples are strings.
    # labels, units: of its channels.
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
    """One device, without its streams."""

    # sensor, unit, participant, label: identity of the device.
    sensor: str
    unit: str
    participant: str
    label: str
    state: str  # A value of `biosensor_gateway.agent.device_states.State`.
    paused: bool  # Whether its participant has withdrawn, so that nothing is sent.
    worn: bool | None  # None if unknown.
    connections: int  # How often it was connected.
    error: str | None  # Why it does not stream, in one sentence; None if nothing is wrong.
    dropped_bytes: int  # Number of received bytes that were not part of a valid message.
    battery_percent: float | None  # None if unknown, and while the device is not connected.
    clock: ClockStatus | None  # None before its first packet.
    # Unix time in seconds since when it is paused or does not stream; None while it streams.
    since: float | None = None
    # What was refused before it became a sample of a stream.
    refusals: list[RefusedStatus] = Field(default_factory=list[RefusedStatus])


class DeviceStatus(DeviceFacts):
    """One device."""

    streams: dict[str, StreamStatus]  # By source_id.
    # Streams that the device's settings declare; empty if the sensor's declaration has them all.
    declared: list[DeclaredStream] = Field(default_factory=list[DeclaredStream])


class AgentFacts(BaseModel):
    """An agent, without its devices; the defaults are for when no agent runs."""

    written: float | None = None  # Time of this status, Unix time in seconds.
    lsl_time: float | None = None  # The same as LSL time, the clock of `newest_s` and `last_stamp`.
    # When the agent began, as LSL time, as in the heartbeats of its events.
    started_s: float | None = None
    process: int | None = None
    virtual: bool = False
    # restarts, last_end: how often the agent was restarted after a crash, and how it ended last.
    restarts: int = 0
    last_end: str = ""
    session: str = ""  # LSL session in which it sends; empty if unknown.
    # What of the agent's own streams was not sent, or not received.
    refusals: list[RefusedStatus] = Field(default_factory=list[RefusedStatus])


class AgentStatus(AgentFacts):
    """An agent with its devices."""

    devices: list[DeviceStatus] = Field(default_factory=list[DeviceStatus])


def declared_streams(sensor: str, own: Sequence[DeclaredStream] = ()) -> tuple[DeclaredStream, ...]:
    """Return the streams of a device.

    Parameters
    ----------
    own
        Streams that the device's settings declare, from its status.

    Raises
    ------
    SpecError
        If *own* is empty, and the sensor's declaration cannot be loaded.
    """
    if own:
        return tuple(own)
    return tuple(DeclaredStream.of(each) for each in declaration(sensor).streams)
