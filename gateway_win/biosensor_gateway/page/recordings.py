"""The recordings that the page knows, and what is in them."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

from fastapi import APIRouter

from biosensor_gateway.page.models import Outcome
from biosensor_gateway.page.routes.recording import Recorder
from biosensor_gateway.page.replay_models import (
    NewReplay,
    RecordedStream,
    RecordingContents,
    RecordingFile,
    RecordingPath,
)
from biosensor_gateway.page.routes.replay import Replaying, whole_path
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.replay import words
from biosensor_gateway.recording.replay.source import opened

MOST_LISTED = 100
_MOST_LOOKED_AT = 20_000
_SUFFIXES = (".xdf", ".xdfz")


def add_replay(router: APIRouter, recorder: Recorder, replaying: Replaying) -> None:
    """Add how recordings are found and played."""

    @router.get("/recordings")
    async def known() -> list[RecordingFile]:
        """List the recordings in the folders that were recorded to, the newest first."""
        going_on = recorder.file_going_on
        found = await asyncio.to_thread(recordings, recorder.folders)
        return [each for each in found if each.path != going_on]

    @router.post("/recordings/contents")
    async def contents(recording: RecordingPath) -> RecordingContents:
        """Say what is in a recording; a long one takes some seconds."""
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
    """Find recordings below some folders, the newest first, `MOST_LISTED` at most."""
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
        # It was there a moment ago.
        return None
    return RecordingFile(path=str(path), name=path.name, bytes=stat.st_size, modified=stat.st_mtime)


def _contents(path: Path) -> RecordingContents:
    with opened(path) as contents:
        return RecordingContents(
            length_s=contents.end_s - contents.begin_s,
            streams=[_stream(each) for each in contents.streams],
            problems=list(words.damaged(contents.damages)),
        )


def _stream(stream: Stream) -> RecordedStream:
    identity = stream.header.identity
    return RecordedStream(
        name=stream.header.name,
        wearer="" if identity is None else identity.participant,
        samples=stream.sample_count,
    )
