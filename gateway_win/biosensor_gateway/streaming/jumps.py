"""Says jumps of a device's clock: one by one while they are few, together when they are many."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from biosensor_gateway.system.clock import Clock

SAID, SAID_S = 3, 60.0
"""So many are said in so many seconds."""


class Jumps(NamedTuple):
    """One jump, or several that are said together.

    Attributes
    ----------
    cause
        Of the last one.
    seconds
        By which they moved the mapping in all; None if that is not known of each.
    times
        How many they are.
    """

    cause: str
    seconds: float | None
    times: int = 1


class JumpReports:
    """Hands jumps on, three a minute at most, so that neither log nor events are flooded.

    Parameters
    ----------
    say
        Is told of each jump, or of several at once.
    """

    def __init__(self, clock: Clock, say: Callable[[Jumps], None]) -> None:
        self._clock = clock
        self._say = say
        self._said_s: deque[float] = deque(maxlen=SAID)
        self._gathered: Jumps | None = None

    def note(self, cause: str, seconds: float | None) -> None:
        """Say a jump now, or gather it."""
        self._gathered = _together(self._gathered, Jumps(cause, seconds))
        self.release()

    def release(self) -> None:
        """Say what was gathered, if it may be said by now; to be called once a second or so."""
        if self._gathered is None:
            return
        now = self._clock()
        if len(self._said_s) < SAID or now - self._said_s[0] >= SAID_S:
            self._said_s.append(now)
            self.finish()

    def finish(self) -> None:
        """Say what was gathered, whenever it was."""
        gathered, self._gathered = self._gathered, None
        if gathered is not None:
            self._say(gathered)


def _together(before: Jumps | None, jump: Jumps) -> Jumps:
    if before is None:
        return jump
    seconds = None
    if before.seconds is not None and jump.seconds is not None:
        seconds = before.seconds + jump.seconds
    return Jumps(jump.cause, seconds, before.times + 1)
