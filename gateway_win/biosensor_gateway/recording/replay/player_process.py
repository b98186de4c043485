"""Plays a recording in a separate process, and reports to the program that started it."""

from __future__ import annotations

import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from enum import StrEnum, unique
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from biosensor_common.errors import GatewayError
from biosensor_common.lsl.network import configure_lsl
from biosensor_common.process_limits import end_within
from biosensor_common.quantities import ChannelFormat, ChannelRole
from biosensor_gateway.agent.feed import ReaderQueue
from biosensor_gateway.agent.feed_frames import FrameKind, frame, samples_frame
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.replay import playback
from biosensor_gateway.recording.replay.playback import Wanted, prepared
from biosensor_gateway.recording.replay.player import Player, PlayOptions
from biosensor_gateway.settings.models import LslSettings
from biosensor_gateway.system.child import first_line, when_input_ends


@unique
class Phase(StrEnum):
    """Phase of a replay."""

    OPENING = "opening"
    WAITING = "waiting"
    PLAYING = "playing"
    ENDED = "ended"
    REFUSED = "refused"


class ReplayJob(BaseModel):
    """What to play; see `Wanted` and the options of ``biosensor-gateway replay``."""

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
            Selection(self.streams, self.begin, self.end),
            PlayOptions(speed=self.speed, loop=self.loop),
            may_be_beside=self.beside_live,
        )


class PlayedStream(BaseModel):
    """One played stream, according to its header."""

    source_id: str
    lsl_name: str
    data_name: str
    is_ours: bool
    # sensor, unit, participant, label: the recorded device and participant; for another program's
    # stream, its name and computer.
    sensor: str
    unit: str
    participant: str
    label: str
    content_type: str
    # channels, units, roles: one per channel; empty for text.
    channels: list[str]
    units: list[str]
    roles: list[ChannelRole | None]
    nominal_hz: float  # At the speed of the replay.
    is_empty: bool  # Whether the recording has no samples of it.


class ReplayProgress(BaseModel):
    """Progress of a replay; times in seconds of the recording."""

    phase: Phase = Phase.OPENING
    lap: int = 0  # Number of rounds started.
    position_s: float = 0.0
    length_s: float = 0.0
    sent: int = 0
    # received, streams: number of streams with a receiver, and number of all streams.
    received: int = 0
    streams: int = 0
    # Sentences for the user: what cannot be played, why it was refused, and a summary at the end.
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


FLUSH_S = 0.04
ENDS_WITHIN_S = 10.0
"""Limit for the end; closing the outlets of many streams takes some seconds."""
_TOLD_EVERY = 12
_ALLOWED_BY = "tick 'also alongside the real sensors'"


def play_for_another() -> int:
    """Play the job on standard input; return the exit code of this process."""
    job = ReplayJob.model_validate_json(first_line())
    configure_lsl(job.lsl.overrides)
    stopping = threading.Event()

    def end() -> None:
        stopping.set()
        # liblsl may hang while it destroys an outlet, and perhaps nobody is left to kill this.
        end_within(ENDS_WITHIN_S)

    when_input_ends(end)
    teller = _Teller(sys.stdout.buffer)
    try:
        said = _play(job, stopping, teller)
    except GatewayError as error:
        teller.tell(Told(progress=ReplayProgress(phase=Phase.REFUSED, said=[str(error)])))
        return 1
    ended = teller.progress.model_copy(update={"phase": Phase.ENDED, "said": said})
    teller.tell(Told(progress=ended))
    return 0


def _play(job: ReplayJob, stopping: threading.Event, teller: _Teller) -> list[str]:
    """Play to the end; return sentences about the result."""
    with prepared(job.wanted, _ALLOWED_BY) as player:
        known = [
            *playback.elsewhere(job.lsl.overrides),
            *playback.damaged(player.damages),
            *playback.left_out(player),
        ]
        player.watch(teller.put)
        with teller.following(player, known):
            teller.tell(Told(progress=teller.progress, streams=played_streams(player, job.speed)))
            player.run(stopping)
        return [*known, *playback.ended(player, was_stopped=stopping.is_set())]


class _Teller:
    """Writes frames from a separate thread, so that a slow reader does not delay samples."""

    def __init__(self, output: BinaryIO) -> None:
        self._output = output
        self._waiting = ReaderQueue()
        self._lock = threading.Lock()
        self.progress = ReplayProgress()

    def put(self, source_id: str, stamps: NDArray[np.float64], values: NDArray[Any]) -> None:
        """Queue samples that were sent."""
        message = samples_frame(source_id, stamps.tolist(), values)
        with self._lock:
            self._waiting.put(message, len(stamps))

    def tell(self, told: Told) -> None:
        """Write a status after the queued frames; does nothing after the reader has gone."""
        with self._lock:
            self._waiting.put(frame(FrameKind.STATUS, told.model_dump_json().encode()), 0)
        self._flush()

    @contextmanager
    def following(self, player: Player, said: list[str]) -> Generator[None]:
        """Report the state of a player while the context is open."""
        is_over = threading.Event()

        def note() -> None:
            now = player.progress()
            self.progress = ReplayProgress(
                phase=Phase.PLAYING if now.lap else Phase.WAITING,
                lap=now.lap,
                position_s=now.position_s,
                length_s=now.length_s,
                sent=now.sent,
                received=now.received,
                streams=len(player.streams),
                said=said,
            )

        def follow() -> None:
            count = 0
            while not is_over.wait(FLUSH_S):
                count += 1
                self._flush()
                if count % _TOLD_EVERY == 0:
                    note()
                    self.tell(Told(progress=self.progress))

        note()
        thread = threading.Thread(target=follow, name="replay-teller", daemon=True)
        thread.start()
        try:
            yield
        finally:
            is_over.set()
            thread.join()
            note()

    def _flush(self) -> None:
        with self._lock:
            messages = self._waiting.take()
        try:
            self._output.write(messages)
            self._output.flush()
        except OSError:
            # The reader has died, which also ends the input and so the replay.
            return
