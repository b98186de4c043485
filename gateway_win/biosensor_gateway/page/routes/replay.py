"""Plays a recording by a button, in a process of its own that ends with the page."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO

from biosensor_common.child import close_input, send
from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.agent.feed_frames import HEAD, FrameKind
from biosensor_gateway.agent.sample_frames import read_samples
from biosensor_gateway.page.models import Outcome
from biosensor_gateway.page.replay_models import NewReplay
from biosensor_gateway.page.session import Session
from biosensor_gateway.recording.replay.errors import ReplayError, ReplayReason
from biosensor_gateway.recording.replay.told import Phase, ReplayJob, ReplayProgress, Told
from biosensor_gateway.system.child import start_for

PLAYER = "play-recording"
"""First argument of the command line that is a player."""
END_S = 10.0
"""Its last samples are still sent, and a large bag is given back."""
_DIED = "the program that plays has ended unexpectedly; play the recording again"


class Replaying:
    """The one replay of this page.

    Parameters
    ----------
    session
        Its `replay` is kept up to date.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._process: subprocess.Popen[bytes] | None = None
        self._begun = asyncio.Event()
        self._over = asyncio.Event()
        self._last = ReplayProgress()

    async def run(self) -> None:
        """Wait until cancelled, and then end what is played."""
        try:
            await asyncio.Event().wait()
        finally:
            self._close_input()

    async def start(self, wanted: NewReplay) -> Outcome:
        """Play a recording; its streams are on the network when this returns.

        Raises
        ------
        ConfigError
            ``IN_USE`` if one is played; ``WRONG_VALUE`` if the file is no whole path.
        ReplayError
            ``REFUSED``, with the reason why it is not played.
        TransportError
            ``ABSENT`` if the system cannot start what plays it.
        """
        if self._session.replay.is_running:
            message = "a recording is being played already; end that replay first"
            raise ConfigError(ConfigReason.IN_USE, message)
        file = whole_path(wanted.path)
        job = ReplayJob(
            file=file, lsl=self._session.loaded().lsl, **wanted.model_dump(exclude={"path"})
        )
        self._begun.clear()
        self._over.clear()
        self._session.replay.begin(file.name, wanted.speed, loop=wanted.loop)
        try:
            self._process = start_for([PLAYER])
        except OSError as error:
            self._session.replay.end()
            message = f"the recording cannot be played: {error.strerror or error}"
            raise TransportError(TransportReason.ABSENT, message) from error
        self._listen(self._process, job)
        await self._begun.wait()
        if self._last.phase is Phase.REFUSED:
            raise ReplayError(ReplayReason.REFUSED, self._last.said[0])
        return Outcome(sentence=f"{file.name} is played; it is no person that is seen now.")

    async def stop(self) -> Outcome:
        """End the replay; none of its streams is on the network when this returns.

        Raises
        ------
        ConfigError
            ``NOT_FOUND`` if there is none.
        """
        if not self._session.replay.is_running:
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
            # The loop may have ended a moment before the thread.
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
            self._session.replay.take(read_samples(content))
        elif kind == FrameKind.STATUS:
            told = Told.model_validate_json(content)
            self._last = told.progress
            if told.streams is not None:
                self._session.replay.show(told.streams)
                self._begun.set()
            # Why it was refused is the answer of the request.
            if told.progress.phase is not Phase.REFUSED:
                is_playing = told.progress.phase is Phase.PLAYING
                self._session.replay.note(told.progress, is_playing=is_playing)

    def _end(self) -> None:
        if self._last.phase is not Phase.REFUSED and self._last.phase is not Phase.ENDED:
            self._last = self._last.model_copy(update={"said": [*self._last.said, _DIED]})
            self._session.replay.note(self._last, is_playing=False)
        self._close_input()
        self._session.replay.end()
        self._begun.set()
        self._over.set()


def whole_path(text: str) -> Path:
    """Return the path of a recording.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE`` if it is relative: to what, nobody who looks at a page knows.
    """
    path = Path(text).expanduser()
    if not path.is_absolute():
        message = f"{text!r} is not a whole path of a recording; begin with the drive or with /"
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
