"""Collects what the programs do not pass on as it came, or double, rename or guess.

Every place that does so reports a member of :class:`biosensor_common.refusal.Refusal` by
:meth:`Refusals.refuse`; a test finds those that do not (``tests/refusals``). What is reported is
shown above OK where a person looks: in ``/diagnostics``, in ``status`` and on the page.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from biosensor_common.refusal import Refusal

LATELY_S = 10.0
"""So long after the last time something is shown that does not stand."""
AGAIN_S = 60.0
"""After so long the log says again what goes on."""
_MOST = 1000
"""More are not remembered: whatever the network has called itself."""


@dataclass(frozen=True, slots=True)
class Refused:
    """What was reported of one thing, and how often.

    Attributes
    ----------
    about
        Which stream or topic it is of; empty if whoever reports has one only.
    count
        In all; of samples, messages or streams, as the sentence has it.
    first_s, last_s
        On the clock of the `Refusals`.
    is_over
        Whether it stood and does no more.
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
        """What a person is told."""
        return self.what.told(self.count, **self.facts)

    @property
    def sentence_about(self) -> str:
        """The same, with what it is about."""
        return f"{self.about}: {self.sentence}" if self.about else self.sentence


class Refusals:
    """What was not passed on as it came, of one stream, topic or program. Any thread may report.

    Parameters
    ----------
    say
        Called with a sentence for the log, of each thing once, and again when it was long away.
    about
        What the sentences for the log are about.
    clock
        In seconds.
    again_s
        How long the log does not repeat what goes on; what stands it says once.
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
        """Report that something is not passed on as it came; the newest facts are kept."""
        now = self._clock()
        with self._lock:
            before = self._told.pop((what, about), None)
            first_s = before.first_s if before else now
            total = count if before is None or what.stands else before.count + count
            told = Refused(what, about, total, first_s, now, facts)
            # At the end: the first ones are those that were reported longest ago.
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
        """Report that something does not stand any more."""
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
        """Report what stands, or that it does not."""
        if is_so:
            self.refuse(what, count, about=about, **facts)
        else:
            self.over(what, about)

    def count(self, *what: Refusal) -> int:
        """Return how much was reported of these, in all."""
        return sum(each.count for each in self.all if each.what in what)

    @property
    def all(self) -> list[Refused]:
        """Everything that is remembered, what was reported last at the end."""
        with self._lock:
            return list(self._told.values())

    @property
    def present(self) -> list[Refused]:
        """What stands, and what was reported within the last seconds; the worst first."""
        now = self._clock()
        shown = [
            each
            for each in self.all
            if not each.is_over and (each.what.stands or now - each.last_s <= LATELY_S)
        ]
        return sorted(shown, key=lambda each: -each.what.level)
