"""A recording that this computer makes by itself: begin it, look at it, end it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from biosensor_common.lsl_config import LslOverrides
from biosensor_gateway.recording.growing.growth import Growth
from biosensor_gateway.recording.here import beside_agent
from biosensor_gateway.recording.here.beside_agent import Devices
from biosensor_gateway.recording.here.memory import RecorderFolder
from biosensor_gateway.recording.here.results import StandingHere, StartedHere, StoppedHere
from biosensor_gateway.recording.here.starting import begin
from biosensor_gateway.recording.here.stopping import end
from biosensor_gateway.recording.labrecorder.results import By
from biosensor_gateway.recording.labrecorder.starting import Order
from biosensor_gateway.recording.labrecorder.streams import Presence
from biosensor_gateway.recording.xdf.findings import Finding, Level


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
