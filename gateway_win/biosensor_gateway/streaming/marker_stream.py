"""The experimenter's markers, in the stream ``gateway/markers``.

Each is one JSON object in a string, without blanks and in ASCII. Every one has

marker
    Its name; ``note`` for a note, ``undo`` for one that undoes another, ``ready`` for the
    agent's own.
kind
    One of :class:`MarkerKind`.
id
    Counts from 1 at each start of the agent: a missing number is a missing marker.
lsl_time
    LSL time in seconds at which it happened. The stamp is the same time, but never before
    the stamp of an earlier marker.

and some

note
    Free text.
source
    The sender.
timed_by
    For a marker from a web experiment, the origin of its ``lsl_time``: one of :class:`TimedBy`.
uncertainty_s
    Largest error of that time in seconds, either way, if it was measured.
of
    For an undo, the ``id`` of the undone marker. Nothing is deleted.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum, unique
from typing import NamedTuple

from biosensor_common.clocks import MonotonicStamps
from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    TransportError,
    TransportReason,
)
from biosensor_common.refusal import Refusal, Refusals
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.outlets import Outlet, log_errors, spare_outlet
from biosensor_gateway.system.clock import LSL_CLOCK, Clock

LINGER_S = 0.25
"""How long the outlet stays after the last marker, which LSL sends from a thread of its own."""
KEPT = 1000
"""The newest markers that are remembered; an older one cannot be undone."""


@unique
class MarkerKind(StrEnum):
    """Origin of a marker."""

    BUTTON = "button"
    """Somebody pressed one of the buttons of the settings."""
    NOTE = "note"
    """Somebody wrote something down."""
    API = "api"
    """A program sent it, or a command."""
    WEB = "web"
    """A web experiment sent it."""
    UNDO = "undo"
    """It takes another one back."""
    READY = "ready"
    """The agent's own: somebody begins to receive, and nobody did before."""


@unique
class TimedBy(StrEnum):
    """How the time of a web experiment's marker was determined."""

    CLOCK = "clock"
    """The browser said when, on its own clock, which was measured."""
    AGE = "age"
    """The browser said how long ago; the time on the way is in it."""
    ARRIVAL = "arrival"
    """It is when the marker came."""


class Timing(NamedTuple):
    """Accuracy of a marker's time."""

    timed_by: TimedBy
    # Largest error in seconds, either way; None if it was not measured.
    uncertainty_s: float | None = None


@dataclass(slots=True)
class Marker:
    """A marker that was sent, whether it was undone, and whether any program received it."""

    id: int
    marker: str
    note: str
    kind: MarkerKind
    source: str
    lsl_time: float
    timing: Timing | None = None
    undone: bool = False
    received: bool = True


class MarkerStream:
    """Sends markers and remembers the newest ones.

    The outlet exists from the agent's start, so that LabRecorder finds it. The first receiver soon
    gets a marker ``ready``, unless another marker is sent before: some versions of the loader for
    MATLAB cannot load a marker stream without markers.
    """

    def __init__(self, clock: Clock = LSL_CLOCK) -> None:
        self.clock = clock  # The LSL clock.
        # Counts markers that nobody receives, or that cannot be sent.
        self.refusals = Refusals(clock=clock)
        self._stamps = MonotonicStamps()
        self._count = 0
        self._kept: dict[int, Marker] = {}
        self._had_consumers = False
        self._outlet: Outlet | None = None

    @property
    def counters(self) -> dict[str, Counters]:
        """Counters of the stream by source_id."""
        return {} if self._outlet is None else {self._outlet.source_id: self._outlet.counters}

    @property
    def is_received(self) -> bool:
        """Whether the stream has a receiver now."""
        return self._outlet is not None and self._outlet.have_consumers()

    def open(self) -> None:
        """Create the outlet; on an error, it is logged and all markers are refused."""
        self._outlet = spare_outlet("markers", self.refusals, self.clock)

    @log_errors
    def tick(self, now: float) -> None:
        """Send ``ready`` to a new receiver; *now* is an LSL time."""
        had_consumers, self._had_consumers = self._had_consumers, self.is_received
        if self._had_consumers and not had_consumers:
            self._send(MarkerKind.READY.value, MarkerKind.READY, now, {})

    def mark(
        self,
        marker: str,
        note: str,
        kind: MarkerKind,
        source: str,
        at: float | None = None,
        timing: Timing | None = None,
    ) -> Marker:
        """Send a marker.

        Parameters
        ----------
        marker, note, kind, source
            Contents of the marker; note and source may be empty.
        at
            LSL time of the event in seconds; now if omitted.
        timing
            Accuracy of that time, if it was measured.

        Raises
        ------
        TransportError
            ``UNAVAILABLE`` if there is no stream.
        """
        happened = self.clock() if at is None else at
        known = {} if timing is None else timing._asdict()
        said = {"note": note, "source": source, **known}
        facts = {name: each for name, each in said.items() if each not in ("", None)}
        number = self._send(marker, kind, happened, facts)
        received = self.is_received
        sent = Marker(
            number, marker, note, kind, source, round(happened, 6), timing, received=received
        )
        self._kept[number] = sent
        if not self.is_received:
            self.refusals.refuse(Refusal.UNHEARD_MARKER)
        if len(self._kept) > KEPT:
            del self._kept[next(iter(self._kept))]
        return sent

    def undo(self, number: int | None = None) -> tuple[int, int]:
        """Send a marker that undoes another one.

        Parameters
        ----------
        number
            Its id; None for the last one that is not undone.

        Returns
        -------
        tuple of int
            The id of the undo, and the id of the undone marker.

        Raises
        ------
        ConfigError
            ``NOT_FOUND`` if there is no such marker, ``WRONG_VALUE`` if it is undone already.
        TransportError
            ``UNAVAILABLE`` if there is no stream.
        """
        wrong = self._last_that_holds() if number is None else self._remembered(number)
        undo = MarkerKind.UNDO
        own = self._send(undo.value, undo, self.clock(), {"of": wrong.id})
        wrong.undone = True
        return own, wrong.id

    def newest(self, count: int) -> list[Marker]:
        """Return the last markers, the newest last, without undos and the agent's own."""
        return list(self._kept.values())[-count:]

    async def end(self) -> None:
        """Destroy the outlet after the markers have been sent."""
        if self._outlet is None:
            # nothing is dropped: there was none, which `spare_outlet` has reported
            return
        if self.is_received:
            await asyncio.sleep(LINGER_S)
        self._outlet.close()
        self._outlet = None

    def _last_that_holds(self) -> Marker:
        for each in reversed(self._kept.values()):
            if not each.undone:
                return each
        raise ConfigError(ConfigReason.NOT_FOUND, "there is no marker to undo")

    def _remembered(self, number: int) -> Marker:
        found = self._kept.get(number)
        if found is None:
            message = f"there is no marker with the id {number} to undo"
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        if found.undone:
            message = f"marker {number} ({found.marker}) is already undone"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        return found

    def _send(
        self, marker: str, kind: MarkerKind, happened: float, facts: Mapping[str, object]
    ) -> int:
        if self._outlet is None:
            message = (
                "there is no marker stream: the agent is starting or ending, or its log says why"
            )
            raise TransportError(TransportReason.UNAVAILABLE, message)
        number = self._count + 1
        content = {
            "marker": marker,
            "kind": kind.value,
            "id": number,
            **facts,
            "lsl_time": round(happened, 6),
        }
        # Whoever gets this one needs no other to begin with.
        self._had_consumers = self.is_received
        (stamp,) = self._stamps.apply([happened])
        self._outlet.push_text(json.dumps(content, separators=(",", ":")), stamp)
        self._count = number
        return number
