"""Collects reports of data that was dropped, changed, duplicated, renamed or guessed.

All code that does so reports a member of :class:`biosensor_common.refusal.Refusal` by
:meth:`Refusals.refuse`; a test finds code that does not (``tests/refusals``). Reports are shown
with a level above OK in ``/diagnostics``, in ``status`` and on the page.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from biosensor_common.refusal import Refusal

LATELY_S = 10.0
"""How long a report that does not last is shown after its latest occurrence."""
AGAIN_S = 60.0
"""After this time the log repeats a report that still occurs."""
_MOST = 1000
"""Limit of remembered reports, because names from the network may be unlimited."""


@dataclass(frozen=True, slots=True)
class Refused:
    """The reports of one kind about one stream or topic.

    Attributes
    ----------
    about
        Its stream or topic; empty if the reporter has only one.
    count
        Total number of samples, messages or streams, according to the sentence.
    first_s, last_s
        Times on the clock of the `Refusals`.
    is_over
        Whether it lasted and has ended.
    """

    what: Refusal
    about: str
    count: int
    first_s: float
    last_s: float
    facts: Mapping[str, object] = field(default_factory=dict[str, object])
    is_over: bool = False

    @property
    def sentence(self) -> str:
        """The sentence for the user."""
        return self.what.told(self.count, **self.facts)

    @property
    def sentence_about(self) -> str:
        """The sentence, preceded by its stream or topic."""
        return f"{self.about}: {self.sentence}" if self.about else self.sentence


class Refusals:
    """Reports of data that was not passed on unchanged; any thread may report.

    Parameters
    ----------
    say
        Called with a sentence for the log: once per report, and again if it returns after a while.
    about
        Subject of the sentences for the log.
    clock
        In seconds.
    again_s
        After how many seconds the log repeats a report; one that lasts is logged once.
    """

    def __init__(
        self,
        say: Callable[[str], object] | None = None,
        about: str = "",
        clock: Callable[[], float] = time.monotonic,
        again_s: float = AGAIN_S,
    ) -> None:
        self._say, self._about, self._clock, self._again_s = say, about, clock, again_s
        self._said: dict[tuple[Refusal, str], float] = {}
        self._lock = threading.Lock()
        self._told: dict[tuple[Refusal, str], Refused] = {}

    def refuse(self, what: Refusal, count: int = 1, *, about: str = "", **facts: object) -> None:
        """Report that data was not passed on unchanged; the newest facts are kept."""
        now = self._clock()
        with self._lock:
            before = self._told.pop((what, about), None)
            first_s = before.first_s if before else now
            total = count if before is None or what.stands else before.count + count
            told = Refused(what, about, total, first_s, now, facts)
            # Moved to the end, so that the oldest reports are at the front and are forgotten first.
            self._told[what, about] = told
            if len(self._told) > _MOST:
                oldest = next(iter(self._told))
                del self._told[oldest]
                self._said.pop(oldest, None)
            is_to_say = self._is_to_say(what, about, before, now)
        if self._say is not None and is_to_say:
            whose = about or self._about
            sentence = what.told(count, **facts)
            self._say(f"{whose}: {sentence}" if whose else sentence)

    def _is_to_say(self, what: Refusal, about: str, before: Refused | None, now: float) -> bool:
        is_due = now - self._said.get((what, about), -math.inf) > self._again_s
        is_new = before is None or before.is_over
        if not (is_new or (is_due and not what.stands)):
            return False
        self._said[what, about] = now
        return True

    def over(self, what: Refusal, about: str = "") -> None:
        """Report that something lasting has ended."""
        with self._lock:
            told = self._told.get((what, about))
            if told is not None and not told.is_over:
                self._told[what, about] = replace(told, is_over=True)

    def hold(
        self,
        what: Refusal,
        is_so: bool,
        count: int = 1,
        *,
        about: str = "",
        **facts: object,
    ) -> None:
        """Report whether something lasting is the case now."""
        if is_so:
            self.refuse(what, count, about=about, **facts)
        else:
            self.over(what, about)

    def count(self, *what: Refusal) -> int:
        """Return the total count of these kinds."""
        return sum(each.count for each in self.all if each.what in what)

    @property
    def all(self) -> list[Refused]:
        """Return all remembered reports, the latest at the end."""
        with self._lock:
            return list(self._told.values())

    @property
    def present(self) -> list[Refused]:
        """Return lasting reports and those of the last seconds, the most severe first."""
        now = self._clock()
        shown = [
            each
            for each in self.all
            if not each.is_over and (each.what.stands or now - each.last_s <= LATELY_S)
        ]
        return sorted(shown, key=lambda each: -each.what.level)
