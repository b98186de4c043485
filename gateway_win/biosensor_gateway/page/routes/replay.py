"""Plays recordings in a separate process that ends with the page."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby, islice
from pathlib import Path
from typing import IO

from fastapi import APIRouter
from pydantic import BaseModel, Field
from pylsl import local_clock

from biosensor_common import naming
from biosensor_common.child import close_input, send
from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_common.quantities import TYPES_OF_DEVICE, ChannelRole
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.feed_frames import HEAD, FrameKind, Samples, read_samples
from biosensor_gateway.agent.rate_meter import RateMeter
from biosensor_gateway.devices.registry import sensor_title
from biosensor_gateway.page.live_feed import Traces, is_of_now
from biosensor_gateway.page.models import (
    Body,
    LongText,
    Outcome,
    PathText,
    ReplayedDeviceView,
    ReplayedStreamView,
    ReplayView,
)
from biosensor_gateway.page.routes.recording import Recorder
from biosensor_gateway.page.session import Session
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.replay import FASTEST, SLOWEST, playback
from biosensor_gateway.recording.replay.player_process import (
    Phase,
    PlayedStream,
    ReplayJob,
    ReplayProgress,
    Told,
)
from biosensor_gateway.recording.replay.source import ReplayError, ReplayReason, opened
from biosensor_gateway.system.child import start_for


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
    """A stream of a recording; `wearer` is empty if the recording names nobody."""

    name: str
    wearer: str
    samples: int


class RecordingContents(BaseModel):
    """Contents of a recording.

    Attributes
    ----------
    length_s
        From the first sample to the last.
    problems
        Parts that cannot be read, one sentence each.
    """

    length_s: float
    streams: list[RecordedStream]
    problems: list[str]


class RecordingPath(Body):
    """Identifies a recording."""

    path: PathText


class NewReplay(RecordingPath):
    """What to play, and how; as the options of ``biosensor-gateway replay``."""

    speed: float = Field(default=1.0, ge=SLOWEST, le=FASTEST)
    begin: LongText = ""
    end: LongText = ""
    streams: list[LongText] = Field(default_factory=list[str], max_length=1024)
    loop: bool = False
    beside_live: bool = False


PLAYER = "play-recording"
"""First argument of the player's command line."""
END_S = 10.0
"""Limit for the player's end, in which it sends its last samples and closes a large bag."""
_DIED = "the player has ended unexpectedly; play the recording again"


class Replaying:
    """The one replay of this page.

    Parameters
    ----------
    session
        Its `replay_view` is set to this replay's.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._replayed = Replayed(session.traces)
        session.replay_view = self._replayed.view
        self._process: subprocess.Popen[bytes] | None = None
        self._begun = asyncio.Event()
        self._over = asyncio.Event()
        self._last = ReplayProgress()

    async def run(self) -> None:
        """Wait until cancelled, then end the replay."""
        try:
            await asyncio.Event().wait()
        finally:
            self._close_input()

    async def start(self, wanted: NewReplay) -> Outcome:
        """Play a recording; its streams are on the network when this returns.

        Raises
        ------
        ConfigError
            ``IN_USE`` if a recording is being played; ``WRONG_VALUE`` if the path is relative.
        ReplayError
            ``REFUSED``, with the reason.
        TransportError
            ``ABSENT`` if the system cannot start the player.
        """
        if self._replayed.is_running:
            message = "a recording is already being played; end that replay first"
            raise ConfigError(ConfigReason.IN_USE, message)
        file = whole_path(wanted.path)
        job = ReplayJob(
            file=file, lsl=self._session.loaded().lsl, **wanted.model_dump(exclude={"path"})
        )
        self._begun.clear()
        self._over.clear()
        self._replayed.begin(file.name, wanted.speed, loop=wanted.loop)
        try:
            self._process = start_for([PLAYER])
        except OSError as error:
            self._replayed.end()
            message = f"the recording cannot be played: {error.strerror or error}"
            raise TransportError(TransportReason.ABSENT, message) from error
        self._listen(self._process, job)
        await self._begun.wait()
        if self._last.phase is Phase.REFUSED:
            raise ReplayError(ReplayReason.REFUSED, self._last.said[0])
        return Outcome(sentence=f"{file.name} is being played; it is not a live measurement.")

    async def stop(self) -> Outcome:
        """End the replay; none of its streams is on the network when this returns.

        Raises
        ------
        ConfigError
            ``NOT_FOUND`` if there is none.
        """
        if not self._replayed.is_running:
            raise ConfigError(ConfigReason.NOT_FOUND, "no recording is being played")
        self._close_input()
        try:
            async with asyncio.timeout(END_S):
                await self._over.wait()
        except TimeoutError:
            assert self._process is not None
            self._process.kill()
            await self._over.wait()
        return Outcome(sentence="The replay has ended.")

    def _close_input(self) -> None:
        if self._process is not None:
            close_input(self._process)

    def _listen(self, process: subprocess.Popen[bytes], job: ReplayJob) -> None:
        loop = asyncio.get_running_loop()
        self._last = ReplayProgress(phase=Phase.REFUSED, said=[_DIED])

        def on_loop(function: Callable[[], None]) -> None:
            # The loop may end a moment before the thread.
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(function)

        def listen() -> None:
            assert process.stdout is not None
            with process.stdout as output, contextlib.suppress(OSError, EOFError, ValueError):
                send(process, job.model_dump_json(exclude_unset=True).encode() + b"\n")
                while True:
                    kind, content = _read_frame(output)
                    on_loop(lambda kind=kind, content=content: self._take(kind, content))
            process.wait()
            on_loop(self._end)

        threading.Thread(target=listen, name="replay-listener", daemon=True).start()

    def _take(self, kind: int, content: bytes) -> None:
        if kind == FrameKind.SAMPLES:
            self._replayed.take(read_samples(content))
        elif kind == FrameKind.STATUS:
            message = Told.model_validate_json(content)
            self._last = message.progress
            if message.streams is not None:
                self._replayed.show(message.streams)
                self._begun.set()
            # The reason of a refusal is in the answer to the request instead.
            if message.progress.phase is not Phase.REFUSED:
                is_playing = message.progress.phase is Phase.PLAYING
                self._replayed.note(message.progress, is_playing=is_playing)

    def _end(self) -> None:
        if self._last.phase is not Phase.REFUSED and self._last.phase is not Phase.ENDED:
            self._last = self._last.model_copy(update={"said": [*self._last.said, _DIED]})
            self._replayed.note(self._last, is_playing=False)
        self._close_input()
        self._replayed.end()
        self._begun.set()
        self._over.set()


def whole_path(text: str) -> Path:
    """Return an absolute path.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if it is relative, because a page has no current folder.
    """
    path = Path(text).expanduser()
    if not path.is_absolute():
        message = f"{text!r} is not the full path of a recording; start with the drive or with /"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return path


def _read_frame(output: IO[bytes]) -> tuple[int, bytes]:
    head = output.read(HEAD.size)
    if len(head) < HEAD.size:
        raise EOFError
    length, kind = HEAD.unpack(head)
    content = output.read(length)
    if len(content) < length:
        raise EOFError
    return kind, content


class Replayed:
    """The view of the replay and its newest samples; used only on the server's loop."""

    def __init__(self, traces: Traces) -> None:
        self._traces = traces
        self._view = ReplayView()
        self._streams: Sequence[PlayedStream] = ()
        self._meters: dict[str, RateMeter] = {}
        self._counts: dict[str, int] = {}

    @property
    def is_running(self) -> bool:
        """Whether a replay is running or being opened."""
        return self._view.is_running

    def begin(self, file: str, speed: float, *, loop: bool) -> None:
        """Show a replay that is being opened."""
        self._view = ReplayView(is_running=True, file=file, speed=speed, loop=loop)

    def show(self, streams: Sequence[PlayedStream]) -> None:
        """Set the streams that are played."""
        self._streams = streams
        self._meters = {each.source_id: RateMeter(each.nominal_hz) for each in streams}
        self._counts = dict.fromkeys(self._meters, 0)

    def take(self, samples: Samples) -> None:
        """Take samples that were sent."""
        source_id = samples.source_id
        if source_id in self._counts and len(samples.stamps):
            self._counts[source_id] += len(samples.stamps)
            self._meters[source_id].note(self._counts[source_id], float(samples.stamps[-1]))
            self._traces.take(samples)

    def note(self, progress: ReplayProgress, *, is_playing: bool) -> None:
        """Update the progress."""
        self._view = self._view.model_copy(
            update={
                "is_playing": is_playing,
                "lap": progress.lap,
                "position_s": progress.position_s,
                "length_s": progress.length_s,
                "sent": progress.sent,
                "received": progress.received,
                "stream_count": progress.streams,
                "said": progress.said,
            }
        )

    def end(self) -> None:
        """Show the replay as ended, without its samples."""
        self._traces.history.forget(self._counts)
        self._streams, self._meters, self._counts = (), {}, {}
        self._view = self._view.model_copy(update={"is_running": False, "is_playing": False})

    def view(self) -> ReplayView:
        """Return the current view."""
        if not self._streams:
            return self._view
        now = local_clock()
        topics = self._topics()
        known = sorted((each for each in self._streams if each.channels), key=_device_of)
        devices = [
            self._device(who, list(parts), topics, now) for who, parts in groupby(known, _device_of)
        ]
        return self._view.model_copy(update={"devices": devices})

    def _topics(self) -> dict[str, str]:
        """Resolve ROS topics as a node with only these streams would."""
        claims = {
            each.source_id: (
                DeviceIdentity(each.sensor, each.unit, each.participant, each.label),
                each.data_name,
            )
            for each in self._streams
            if each.is_ours
        }
        return {key: f"/{name.name}" for key, name in naming.resolve_topics(claims).items()}

    def _device(
        self, who: tuple[str, ...], streams: list[PlayedStream], topics: dict[str, str], now: float
    ) -> ReplayedDeviceView:
        first = streams[0]
        return ReplayedDeviceView(
            name=f"replay of {'/'.join(each for each in who if each)}",
            title=sensor_title(first.sensor),
            unit=first.unit,
            participant=first.participant,
            label=first.label,
            battery_percent=self._battery(streams),
            streams={
                each.source_id: self._stream(each, topics, now)
                for each in sorted(streams, key=_rank)
            },
        )

    def _stream(
        self, stream: PlayedStream, topics: dict[str, str], now: float
    ) -> ReplayedStreamView:
        newest = self._traces.history.newest(stream.source_id)
        age_s = max(0.0, now - newest[0]) if newest else None
        is_regular, is_signal = stream.nominal_hz > 0, stream.content_type not in TYPES_OF_DEVICE
        is_fresh = is_of_now(age_s, nominal_hz=stream.nominal_hz, is_signal=is_signal)
        meter = self._meters[stream.source_id]
        return ReplayedStreamView(
            source_id=stream.source_id,
            data_name=stream.data_name,
            lsl_name=stream.lsl_name,
            topic=topics.get(stream.source_id, ""),
            content_type=stream.content_type,
            channels=stream.channels,
            units=stream.units,
            nominal_hz=stream.nominal_hz,
            is_empty=stream.is_empty,
            measured_hz=meter.rate_hz(now) if is_regular else None,
            age_s=age_s,
            is_fresh=is_fresh,
            is_signal=is_signal,
            values=newest[1] if newest and is_fresh else [],
        )

    def _battery(self, streams: Sequence[PlayedStream]) -> float | None:
        for each in streams:
            if ChannelRole.STATE_OF_CHARGE in each.roles:
                newest = self._traces.history.newest(each.source_id)
                return newest[1][each.roles.index(ChannelRole.STATE_OF_CHARGE)] if newest else None
        return None


def _rank(stream: PlayedStream) -> tuple[object, ...]:
    """Return a sort key: signals of the body, the fastest first; then the rest."""
    return (stream.content_type in TYPES_OF_DEVICE, -stream.nominal_hz, stream.data_name)


def _device_of(stream: PlayedStream) -> tuple[str, ...]:
    return (stream.participant, stream.sensor, stream.unit, stream.label)


MOST_LISTED = 100
_MOST_LOOKED_AT = 20_000
_SUFFIXES = (".xdf", ".xdfz")


def add_replay(router: APIRouter, recorder: Recorder, replaying: Replaying) -> None:
    """Add the routes that find and play recordings."""

    @router.get("/recordings")
    async def known() -> list[RecordingFile]:
        """List the recordings in the folders that were recorded to, the newest first."""
        going_on = recorder.file_going_on
        found = await asyncio.to_thread(recordings, recorder.folders)
        return [each for each in found if each.path != going_on]

    @router.post("/recordings/contents")
    async def contents(recording: RecordingPath) -> RecordingContents:
        """List the contents of a recording; a long one takes some seconds."""
        return await asyncio.to_thread(_contents, whole_path(recording.path))

    @router.post("/replay/start")
    async def start(wanted: NewReplay) -> Outcome:
        """Play a recording as LSL streams."""
        return await replaying.start(wanted)

    @router.post("/replay/stop")
    async def stop() -> Outcome:
        """End the replay."""
        return await replaying.stop()


def recordings(folders: Iterable[Path]) -> list[RecordingFile]:
    """Find recordings below some folders, the newest first, at most `MOST_LISTED`."""
    paths = {path for folder in folders for path in islice(_below(folder), _MOST_LOOKED_AT)}
    found = [_described(path) for path in paths if path.suffix.lower() in _SUFFIXES]
    known = sorted((each for each in found if each), key=lambda each: -each.modified)
    return known[:MOST_LISTED]


def _below(folder: Path) -> Iterator[Path]:
    for place, _, names in os.walk(folder):
        yield from (Path(place, name) for name in names)


def _described(path: Path) -> RecordingFile | None:
    try:
        stat = path.stat()
    except OSError:
        # Removed since it was found.
        return None
    return RecordingFile(path=str(path), name=path.name, bytes=stat.st_size, modified=stat.st_mtime)


def _contents(path: Path) -> RecordingContents:
    with opened(path) as contents:
        return RecordingContents(
            length_s=contents.end_s - contents.begin_s,
            streams=[_stream(each) for each in contents.streams],
            problems=list(playback.damaged(contents.damages)),
        )


def _stream(stream: Stream) -> RecordedStream:
    identity = stream.header.identity
    return RecordedStream(
        name=stream.header.title,
        wearer="" if identity is None else identity.participant,
        samples=stream.sample_count,
    )
