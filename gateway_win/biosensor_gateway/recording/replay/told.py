"""Messages between a player process and the program that started it."""

from __future__ import annotations

from enum import StrEnum, unique
from pathlib import Path

from pydantic import BaseModel, Field

from biosensor_common.quantities import ChannelFormat, ChannelRole
from biosensor_gateway.recording.contents.choice import Wish
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.replay.player import Order, Player
from biosensor_gateway.recording.replay.playing import Wanted
from biosensor_gateway.settings.models import LslSettings


@unique
class Phase(StrEnum):
    """Phase of a replay."""

    OPENING = "opening"
    WAITING = "waiting"
    PLAYING = "playing"
    ENDED = "ended"
    REFUSED = "refused"


class ReplayJob(BaseModel):
    """What to play; see `Wanted` and the options of ``biosensor-gateway replay``.

    Attributes
    ----------
    lsl
        LSL section of the settings.
    """

    file: Path
    speed: float = 1.0
    begin: str = ""
    end: str = ""
    streams: list[str] = Field(default_factory=list[str])
    loop: bool = False
    beside_live: bool = False
    lsl: LslSettings = LslSettings()

    @property
    def wanted(self) -> Wanted:
        """The job in the form that `prepared` takes."""
        return Wanted(
            self.file,
            Wish(self.streams, self.begin, self.end),
            Order(speed=self.speed, loop=self.loop),
            may_be_beside=self.beside_live,
        )


class PlayedStream(BaseModel):
    """One played stream, according to its header.

    Attributes
    ----------
    source_id
        The source_id of the played stream.
    sensor, unit, participant, label
        The recorded device and participant; for another program's stream, its name and computer.
    channels, units, roles
        One per channel; empty for text.
    nominal_hz
        At the speed of the replay.
    is_empty
        Whether the recording has no samples of it.
    """

    source_id: str
    lsl_name: str
    data_name: str
    is_ours: bool
    sensor: str
    unit: str
    participant: str
    label: str
    content_type: str
    channels: list[str]
    units: list[str]
    roles: list[ChannelRole | None]
    nominal_hz: float
    is_empty: bool


class ReplayProgress(BaseModel):
    """Progress of a replay; times in seconds of the recording.

    Attributes
    ----------
    lap
        Number of rounds started.
    received, streams
        Number of streams with a receiver, and number of all streams.
    said
        Sentences for the user: what cannot be played, why it was refused, and a summary at the
        end.
    """

    phase: Phase = Phase.OPENING
    lap: int = 0
    position_s: float = 0.0
    length_s: float = 0.0
    sent: int = 0
    received: int = 0
    streams: int = 0
    said: list[str] = Field(default_factory=list[str])


class Told(BaseModel):
    """A report of the process; the streams are included once, when they are on the network."""

    progress: ReplayProgress
    streams: list[PlayedStream] | None = None


def played_streams(player: Player, speed: float) -> list[PlayedStream]:
    """Describe the streams that a player offers."""
    both = zip(player.streams, player.own_ids, strict=True)
    return [_described(stream, source_id, speed) for stream, source_id in both]


def _described(stream: Stream, source_id: str, speed: float) -> PlayedStream:
    header, meaning = stream.header, stream.meaning
    identity = header.identity
    is_text = header.format is ChannelFormat.STRING
    return PlayedStream(
        source_id=source_id,
        lsl_name=header.name,
        data_name=header.data_name or header.content_type,
        is_ours=identity is not None,
        sensor=header.name if identity is None else identity.sensor,
        unit=header.hostname if identity is None else identity.unit,
        participant="" if identity is None else identity.participant,
        label="" if identity is None else identity.label,
        content_type=header.content_type,
        channels=[] if is_text else [label or str(n) for n, label in enumerate(header.labels, 1)],
        units=[] if is_text else [unit or "none" for unit in meaning.units],
        roles=[] if is_text else list(meaning.roles),
        nominal_hz=header.rate * speed,
        is_empty=not stream.sample_count,
    )
