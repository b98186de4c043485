"""A recording that this computer makes by itself: begin it, look at it, end it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from biosensor_common.lsl_config import LslOverrides
from biosensor_gateway.recording.here import beside_agent
from biosensor_gateway.recording.here.beside_agent import Devices
from biosensor_gateway.recording.here.errors import (
    NotClosedError,
    RecorderError,
    RecorderReason,
)
from biosensor_gateway.recording.here.program import PROGRAM_NAME
from biosensor_gateway.recording.here.results import StandingHere, StartedHere, StoppedHere
from biosensor_gateway.recording.here.starting import begin
from biosensor_gateway.recording.here.ways import RECORD_STREAMS
from biosensor_gateway.recording.labrecorder.recording_file import Glance, wait_until_closed
from biosensor_gateway.recording.labrecorder.starting import Order
from biosensor_gateway.recording.recorder.live_file import Growth
from biosensor_gateway.recording.recorder.program import Said
from biosensor_gateway.recording.recorder.result import By
from biosensor_gateway.recording.recorder.state import Kept, RecorderFolder
from biosensor_gateway.recording.recorder.streams import Presence
from biosensor_gateway.recording.recorder.supervisor import END_S
from biosensor_gateway.recording.xdf.container import RecordingError
from biosensor_gateway.recording.xdf.expectation import ExpectedStream
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.verdict import check

_MARGIN_S = 10.0
_STILL_S = 0.5
"""The program has ended, so nothing is written any more."""
_CLOSING_S = 30.0


class Recording:
    """The one recording that this computer makes by itself for a state folder.

    It belongs to no process: whoever has the state folder can look at it and end it. Each
    object reads the file on from where it was when it looked last, so keep one to watch.

    Parameters
    ----------
    state
        The state folder.
    """

    def __init__(self, state: Path) -> None:
        self._state = state.absolute()
        self._folder = RecorderFolder(self._state)
        self._growth: tuple[Path, float, Growth] | None = None

    @property
    def is_running(self) -> bool:
        """Whether it records."""
        return self._folder.is_kept()

    @property
    def file(self) -> Path | None:
        """Where it records to, or did when it died; None if there is none, or it was ended."""
        kept = self._folder.kept()
        return None if kept is None else Path(kept.file)

    @property
    def file_going_on(self) -> Path | None:
        """Where it records to; None if it does not."""
        return self.file if self.is_running else None

    def start(
        self,
        order: Order,
        look: Callable[[], Presence],
        lsl: LslOverrides | None = None,
        *,
        counts_up: bool = True,
    ) -> StartedHere:
        """Begin to record; all streams are open when this returns.

        Parameters
        ----------
        order
            What to record. Streams of others are recorded, too, unless it says `only_ours`;
            `growth_s` is how long it may take to open all.
        look
            Looks for the streams there are.
        lsl
            What our settings say of LSL.
        counts_up
            Whether a BIDS name whose run is taken gets the next one.

        Raises
        ------
        RecorderError
            With the reason why nothing is recorded.
        ConfigError
            If `order` makes no sense.
        """
        return begin(self._state, order, look, lsl or LslOverrides(), counts_up=counts_up)

    def stop(self) -> StoppedHere:
        """End it, see the file closed, and judge it. Takes some seconds.

        Raises
        ------
        RecorderError
            ``NOT_RECORDING``, or ``NOT_CLOSED`` with what is known of why.
        """
        return end(self._folder)

    def standing(self, devices: Devices | None = ()) -> StandingHere | None:
        """Look at it; None if there is none, or it was ended.

        Parameters
        ----------
        devices
            What the agent says of its devices; None if no agent runs.
        """
        is_running, kept = self._folder.is_kept(), self._folder.kept()
        if kept is None:
            return None
        growth = self._growth_of(Path(kept.file), kept.started)
        problem = "" if is_running else kept.problem or self._why_it_ended(kept.ended)
        findings = [Finding(Level.ERROR, "ended", "", problem)] if problem else []
        try:
            sight = growth.look()
        except OSError as error:
            sight = None
            text = f"{kept.file} cannot be read ({error.strerror or error})"
            findings.append(Finding(Level.ERROR, "unreadable", "", text))
        streams = () if sight is None else sight.streams
        if is_running:
            recorded = {each.source_id for each in streams}
            # Streams of other programs are recorded without an agent, too.
            if devices is not None or kept.required:
                findings += beside_agent.findings(devices, recorded, kept.started)
            silent = beside_agent.excused(devices, kept.started)
            findings += [*growth.problems(kept.required, silent), *growth.gaps()]
            findings.sort(key=lambda each: list(Level).index(each.level))
        return StandingHere(
            by=By.GATEWAY,
            recording=is_running,
            file=Path(kept.file),
            started=kept.started,
            bytes=0 if sight is None else sight.bytes,
            streams=len(streams),
            with_samples=sum(each.samples > 0 for each in streams),
            is_closed=sight is not None and sight.is_closed,
            required=kept.required,
            sight=sight,
            problems=tuple(findings),
        )

    def _growth_of(self, file: Path, started: float) -> Growth:
        if self._growth is None or self._growth[:2] != (file, started):
            self._growth = (file, started, Growth(file))
        return self._growth[2]

    def _why_it_ended(self, ended: float) -> str:
        """Say why nobody keeps it any more; nothing while who has ended it looks at its file."""
        if ended and self._folder.is_asked_to_stop():
            return ""
        if ended:
            # As its service did, or the computer.
            return "the recording was ended from outside; see its verdict: record stop"
        return "the recording's keeper was killed, and the recording ended with it"


def not_recording() -> RecorderError:
    """Return what is said where there is nothing to end or to look at."""
    message = "nothing is being recorded here; begin with: biosensor-gateway record start"
    return RecorderError(RecorderReason.NOT_RECORDING, message)


def end(folder: RecorderFolder) -> StoppedHere:
    """End a recording; see `Recording.stop`."""
    begun = time.monotonic()
    if folder.is_kept():
        _ask(folder)
    kept = folder.kept()
    if kept is None:
        raise not_recording()
    file = Path(kept.file)
    if not kept.ended:
        _wait_for_program(kept)
    seen = wait_until_closed(file, _STILL_S, _CLOSING_S)
    folder.forget()
    said = Said(folder.what_was_said())
    expected = [ExpectedStream(each, each) for each in kept.required]
    if seen is None:
        message = f"{kept.file} still grows, though nobody keeps it; record stop --file looks again"
        raise RecorderError(RecorderReason.NOT_CLOSED, message)
    if not seen.is_closed:
        verdict = None
        with contextlib.suppress(RecordingError):
            verdict = check(file, expected, kept.without, said.notes)
        why = _why_not_closed(kept, seen)
        message = (
            f"{kept.file}: {why}. Look at it with: biosensor-gateway xdf check. The last that "
            f"{kept.recorder} said: {said.end}"
        )
        raise NotClosedError(message, why, verdict)
    took_s = time.monotonic() - begun
    return StoppedHere(
        by=By.GATEWAY,
        verified=True,
        file=file,
        bytes=seen.bytes,
        streams=len(seen.streams),
        with_samples=len(seen.with_samples),
        took_s=took_s,
        verdict=check(file, expected, kept.without, said.notes),
        warnings=tuple(_warnings(kept)),
    )


def _ask(folder: RecorderFolder) -> None:
    try:
        folder.ask_to_stop()
    except OSError as error:
        message = (
            f"the recording cannot be told to end: {folder.path} cannot be written "
            f"({error.strerror or error})"
        )
        raise RecorderError(RecorderReason.UNWRITABLE, message) from error
    limit_s = END_S + _MARGIN_S
    if not folder.wait_until_free(limit_s):
        message = f"the recording did not end within {limit_s:g} s; look at it with: record status"
        raise RecorderError(RecorderReason.NOT_CLOSED, message)


def _wait_for_program(kept: Kept) -> None:
    """Wait while the program closes its file, whose keeper was killed."""
    with contextlib.suppress(psutil.Error):
        program = psutil.Process(kept.program)
        # Some other may have its number by now.
        if program.name().startswith(PROGRAM_NAME) or RECORD_STREAMS in program.cmdline():
            program.wait(END_S)


def _why_not_closed(kept: Kept, seen: Glance) -> str:
    what = (
        "it is empty" if not seen.bytes else "it was not closed: it breaks off, or its disk is full"
    )
    return f"{kept.problem}; {what}" if kept.problem else what


def _warnings(kept: Kept) -> list[str]:
    if kept.problem:
        return [kept.problem]
    return [] if kept.ended else ["the recording's keeper was killed, so it had ended before"]
