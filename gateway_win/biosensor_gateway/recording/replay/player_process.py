"""Plays a recording in a separate process, for a program that displays it.

The process reads its job as a line of JSON. The end of its input ends the replay, also when the
program that started it crashes. The output consists of frames as in the agent's feed, see
`biosensor_gateway.agent.feed_frames`; each ``STATUS`` contains a `Told` as JSON.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from biosensor_common.errors import GatewayError
from biosensor_common.lsl.network import configure_lsl
from biosensor_common.process_limits import end_within
from biosensor_gateway.agent.feed import ReaderQueue
from biosensor_gateway.agent.feed_frames import FrameKind, frame
from biosensor_gateway.agent.sample_frames import samples_frame
from biosensor_gateway.recording.replay import words
from biosensor_gateway.recording.replay.player import Player
from biosensor_gateway.recording.replay.playing import prepared
from biosensor_gateway.recording.replay.told import (
    Phase,
    ReplayJob,
    ReplayProgress,
    Told,
    played_streams,
)
from biosensor_gateway.system.child import first_line, when_input_ends

FLUSH_S = 0.04
ENDS_WITHIN_S = 10.0
"""Limit for the end; closing the outlets of many streams takes some seconds."""
_TOLD_EVERY = 12
_ALLOWED_BY = "tick 'also beside the real sensors'"


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
        known = [*words.damaged(player.damages), *words.left_out(player)]
        player.watch(teller.put)
        with teller.following(player, known):
            teller.tell(Told(progress=teller.progress, streams=played_streams(player, job.speed)))
            player.run(stopping)
        return [*known, *words.ended(player, was_stopped=stopping.is_set())]


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
