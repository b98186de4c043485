"""Starts and stops a recording, and watches its growing file."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

from fastapi import APIRouter

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.device_states import (
    Absence,
    absences,
    clock_time,
    identity_of,
    is_sending,
)
from biosensor_gateway.page.advice import clicked
from biosensor_gateway.page.models import (
    Body,
    Choice,
    Outcome,
    PathText,
    RecordingView,
    VerdictView,
    all_explained,
    sentence,
)
from biosensor_gateway.page.routes.api import QuestionError
from biosensor_gateway.page.session import Session
from biosensor_gateway.recording.participants import Mismatch, OtherParticipantsError, compare
from biosensor_gateway.recording.recorder.local import LocalRecorder
from biosensor_gateway.recording.recorder.presence import live_features, titles
from biosensor_gateway.recording.recorder.request import (
    BidsLabels,
    LocalStarted,
    LocalStatus,
    NotClosedError,
    RecordingRequest,
    SensorsAwayError,
)
from biosensor_gateway.recording.xdf.container import RecordingError
from biosensor_gateway.recording.xdf.findings import Finding, Level, by_event
from biosensor_gateway.recording.xdf.salvage.outcome import salvage, salvaged_path
from biosensor_gateway.recording.xdf.verdict import Colour, Verdict
from biosensor_gateway.settings.places import usual_recordings_folder, warnings_of


class NewRecording(Body):
    """Name of a new recording, by BIDS entities, with its folder and options.

    Attributes
    ----------
    folder
        Empty for the default folder.
    only_ours
        Leave out streams of other programs, including live features.
    allow_missing
        Record even if streams of the agent's devices are missing.
    set_sensors
        Set the participant of all sensors first.
    other_participants
        Record even if other people than the participant wear the sensors.
    without_away
        Record even if sensors are paused or do not stream.
    """

    participant: str
    session: str = "S001"
    task: str = "Default"
    folder: PathText = ""
    only_ours: bool = False
    allow_missing: bool = False
    set_sensors: bool = False
    other_participants: bool = False
    without_away: bool = False


def add_recording(router: APIRouter, recorder: Recorder) -> None:
    """Add the routes that start and stop a recording, and salvage a truncated one."""

    @router.post("/recording/start")
    async def start(recording: NewRecording) -> Outcome:
        """Begin to record all streams."""
        return await recorder.start(recording)

    @router.post("/recording/stop")
    async def stop() -> Outcome:
        """End the recording, and check it."""
        return await recorder.stop()

    @router.post("/recording/salvage")
    async def salvage() -> Outcome:
        """Write the readable part of a truncated recording to a file next to it."""
        return await recorder.salvage()


LOOK_S = 1.0
_MOST_TOLD_OF = 20
"""Number of absences of sensors that are listed, the newest."""


class Recorder:
    """Controls the recording of this computer, and keeps its view up to date.

    Parameters
    ----------
    session
        Its `recording` is kept up to date.
    """

    def __init__(
        self, session: Session, set_participant: Callable[[str], Awaitable[object]]
    ) -> None:
        self._session = session
        self._set_participant = set_participant
        self._recording = LocalRecorder(session.folder)
        self._busy = ""
        self._looking = asyncio.Lock()
        self._verdict: VerdictView | None = None
        self._folder = usual_recordings_folder()
        self._used: set[Path] = set()
        self._story = Story()

    async def run(self) -> None:
        """Look at the file every second, until cancelled."""
        while True:
            await self._show()
            await asyncio.sleep(LOOK_S)

    @property
    def folders(self) -> set[Path]:
        """The folders of recordings that were made here."""
        file = self._recording.file
        return {self._folder, *self._used, *((file.parent,) if file else ())}

    @property
    def file_going_on(self) -> str:
        """Path of the file that is being recorded; empty if there is none."""
        return str(self._recording.file_going_on or "")

    async def start(self, wanted: NewRecording) -> Outcome:
        """Begin to record.

        Raises
        ------
        ConfigError, RecorderError
            If nothing can be recorded; a `QuestionError` if other people wear the sensors.
        """
        labels = BidsLabels(wanted.participant, wanted.session, wanted.task)
        mismatch = compare(wanted.participant, self._session.worn())
        if mismatch and not wanted.set_sensors and not wanted.other_participants:
            raise self._question(mismatch)
        with self._doing("starting"):
            if wanted.set_sensors:
                await self._set_participant(wanted.participant)
            if not wanted.without_away:
                _require_sensors(self._session.device_facts() or ())
            try:
                begun = await asyncio.to_thread(self._start, wanted, labels)
            except OtherParticipantsError as error:
                raise self._question(error.mismatch) from error
            except SensorsAwayError as error:
                raise _away_question(error.sentences) from error
        self._verdict = None
        self._story = Story(begun)
        await self._show()
        said = dict.fromkeys((*begun.warnings, *self._story.remarks))
        notes = "".join(f" Note: {each}." for each in said)
        return Outcome(sentence=f"{begun.file} is being recorded.{notes}")

    async def stop(self) -> Outcome:
        """End the recording and check it.

        Raises
        ------
        RecorderError
            If it could not be ended, or there is none.
        """
        file = self._recording.file
        with self._doing("ending"):
            try:
                ended = await asyncio.to_thread(self._recording.stop)
                self._verdict = _view(ended.verdict, ended.warnings)
            except NotClosedError as error:
                self._verdict = _unclosed(str(file), error)
        await self._show()
        return Outcome(sentence=self._verdict.sentence)

    async def salvage(self) -> Outcome:
        """Write the readable part of the last recording to a file next to it.

        Raises
        ------
        ConfigError, RecordingError
            If there is nothing to salvage, or the file cannot be written.
        """
        verdict = self._verdict
        if verdict is None or not verdict.can_be_salvaged or verdict.salvaged:
            message = "no recording here was cut off and could be salvaged"
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        file = Path(verdict.file)
        outcome = await asyncio.to_thread(salvage, file, salvaged_path(file))
        salvaged = str(outcome.written or file)
        self._verdict = verdict.model_copy(update={"salvaged": salvaged})
        await self._show()
        return Outcome(sentence=f"All its readable data is in {salvaged}.")

    async def _show(self) -> None:
        """Update the view, except while a recording starts, when streams are still missing."""
        # One look at a time, because they share the reader of the growing file.
        async with self._looking:
            if self._busy:
                return
            view = await asyncio.to_thread(self._look)
            if not self._busy:
                self._session.recording = view

    @contextmanager
    def _doing(self, what: str) -> Generator[None]:
        if self._busy:
            message = f"the recording is {self._busy} already; wait a moment"
            raise ConfigError(ConfigReason.IN_USE, message)
        self._busy = what
        self._show_busy(what)
        with ExitStack() as failed:
            failed.callback(self._show_busy, "")
            try:
                yield
            finally:
                self._busy = ""
            failed.pop_all()

    def _show_busy(self, what: str) -> None:
        self._session.recording = self._session.recording.model_copy(update={"busy": what})

    def _start(self, wanted: NewRecording, labels: BidsLabels) -> LocalStarted:
        folder = Path(wanted.folder).expanduser() if wanted.folder else self._folder
        if not folder.is_absolute():
            message = f"the folder {wanted.folder!r} is not a full path, such as {self._folder}"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            message = f"cannot make the folder {folder}: {error.strerror or error}"
            raise ConfigError(ConfigReason.UNREADABLE, message) from error
        self._used.add(folder)
        request = RecordingRequest(
            folder,
            labels=labels,
            # No warning of other programs' streams, because the page names them all the time.
            all_streams=not wanted.only_ours,
            only_ours=wanted.only_ours,
            allow_missing=wanted.allow_missing,
            other_participants=wanted.other_participants,
            without_away=wanted.without_away,
        )
        return self._recording.start(request, self._session.loaded())

    def _question(self, mismatch: Mismatch) -> QuestionError:
        choices = [Choice(words="Record as it is", more={"other_participants": True})]
        if self._session.can_be_one_persons:
            words = f"Set all sensors to {mismatch.named}, and record"
            choices.insert(0, Choice(words=words, more={"set_sensors": True}))
        sentence = f"{mismatch.sentence[0].upper()}{mismatch.sentence[1:]}."
        return QuestionError("Who wears the sensors?", sentence, choices)

    def _look(self) -> RecordingView:
        devices = self._session.device_facts()
        standing = self._recording.status(devices, self._session.agent_started_s)
        view = RecordingView(folder=str(self._folder))
        if standing is None:
            return view.model_copy(update={"verdict": self._last_verdict()})
        if not self._story.is_of(standing):
            self._story = Story()
        if standing.recording:
            self._story.look(devices or (), standing)
        # Another program has asked for its end, and checks it.
        is_ending = not standing.recording and all(
            each.code != "ended" for each in standing.problems
        )
        sight = standing.sight
        events = [
            (head.level, "; ".join(map(sentence, [head, *consequences])))
            for head, consequences in by_event(standing.problems)
        ]
        problems = [text for level, text in events if level is Level.ERROR]
        notes = [text for level, text in events if level is not Level.ERROR]
        notes += self._story.notes
        return view.model_copy(
            update={
                "is_running": standing.recording or is_ending,
                "busy": "ending" if is_ending else "",
                "file": str(standing.file),
                "started": standing.started,
                "elapsed_s": max(0.0, standing.elapsed_s or 0.0),
                "bytes": 0 if sight is None else sight.bytes,
                "streams": 0 if sight is None else len(sight.streams),
                "colour": "red" if problems else "amber" if notes else "green",
                "problems": problems,
                "notes": notes,
                "remarks": self._story.remarks,
            }
        )

    def _last_verdict(self) -> VerdictView | None:
        """Return the verdict on the last recording, which another program may have stopped."""
        with suppress(RecordingError):
            verdict = self._recording.stopped_elsewhere()
            if verdict is not None and not self._busy:
                self._verdict = _view(verdict)
        return self._verdict


def _view(verdict: Verdict, warnings: Iterable[str] = ()) -> VerdictView:
    findings = [*verdict.findings, *_told(Level.WARNING, *warnings)]
    return VerdictView(
        colour=str(verdict.colour.value),
        sentence=clicked(verdict.sentence),
        file=verdict.file,
        findings=list(map(sentence, findings)),
        explained=all_explained(findings),
        can_be_salvaged=verdict.can_be_salvaged,
    )


def _unclosed(file: str, error: NotClosedError) -> VerdictView:
    """Return the verdict on a recording that was not closed, as on a full disk."""
    verdict = error.verdict
    findings = [*_told(Level.ERROR, error.why), *(verdict.findings if verdict else ())]
    return VerdictView(
        colour=str(Colour.RED.value),
        sentence=clicked(verdict.sentence) if verdict else "none of it can be read",
        file=verdict.file if verdict else file,
        findings=list(map(sentence, findings)),
        explained=all_explained(findings),
        can_be_salvaged=verdict is not None and verdict.can_be_salvaged,
    )


def _told(level: Level, *sentences: str) -> list[Finding]:
    return [Finding(level, "told", "", each) for each in sentences]


def _require_sensors(devices: Sequence[Mapping[str, Any]]) -> None:
    """Ask about missing sensors at once, before the search for streams, which takes seconds."""
    away = [each.sentence for each in absences(devices) if not each.is_partial]
    if away:
        raise _away_question(away)


def _away_question(sentences: Sequence[str]) -> QuestionError:
    one = len(sentences) == 1
    words = f"Record without {'it' if one else 'them'}"
    # Without a capital letter, because they begin with a participant's name.
    said = [f"{each.rstrip('.')}." for each in sentences]
    return QuestionError(
        "A sensor does not stream" if one else f"{len(sentences)} sensors do not stream",
        f"{' '.join(said)} {words}?",
        [Choice(words=words, more={"without_away": True})],
    )


class Story:
    """Notes about one recording that its status does not have."""

    def __init__(self, begun: LocalStarted | None = None) -> None:
        self._file = begun.file if begun else None
        self._started: float | None = None
        self._warnings = [] if begun is None else [*begun.left_out]
        self._away: dict[DeviceIdentity, Absence] = {}
        self._over: list[str] = []
        self.remarks: list[str] = []  # Information that needs no action.
        if begun:
            self.remarks = [*_others_streams(begun), *warnings_of(begun.file.parent)]

    @property
    def notes(self) -> list[str]:
        """Present and past deviations."""
        return [*self._warnings, *self._over]

    def is_of(self, standing: LocalStatus) -> bool:
        """Whether these are the notes of this recording."""
        if self._started is None:
            return self._file in (None, standing.file)
        return (self._file, self._started) == (standing.file, standing.started)

    def look(self, devices: Sequence[Mapping[str, Any]], standing: LocalStatus) -> None:
        """Note which sensors send a part of their streams, and which send all again.

        The file's events show those that were paused or not connected.
        """
        self._file, self._started = standing.file, standing.started
        sends = {identity_of(e) for e in devices if is_sending(e["state"], paused=e["paused"])}
        now = {each.device: each for each in absences(devices) if each.device in sends}
        here = {identity_of(each) for each in devices}
        for device, before in self._away.items():
            if device in here and device not in now:
                self._over = [*self._over[1 - _MOST_TOLD_OF :], _was_away(before, time.time())]
        # While the agent is away, the state of its sensors is unknown.
        kept = {device: each for device, each in self._away.items() if device not in here}
        self._away = kept | now


def _others_streams(begun: LocalStarted) -> Iterator[str]:
    """Yield sentences about recorded streams that are not the agent's; features are counted."""
    features = live_features(begun.streams, begun.foreign)
    if features:
        are = (
            "1 stream of live features is"
            if len(features) == 1
            else (f"{len(features)} streams of live features are")
        )
        yield f"{are} recorded, too"
    others = [each for each in begun.foreign if each not in features]
    if others:
        yield f"streams of other programs are also recorded: {titles(others)}"


def _was_away(absence: Absence, until: float) -> str:
    since = "" if absence.since is None else f"from {clock_time(absence.since, seconds=True)} "
    until_when = f"until {clock_time(until, seconds=True)}"
    return f"{absence.name} did not send all of its data {since}{until_when}"
