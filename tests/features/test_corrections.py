"""How often a sender is asked for its clock: one that hangs takes no time from others."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from biosensor_gateway.features.links import Correction


class Sender:
    """A sender that answers, or hangs."""

    def __init__(self) -> None:
        self.hangs, self.asked = False, 0

    def time_correction(self, timeout: float, /) -> float:
        del timeout
        self.asked += 1
        if self.hangs:
            raise TimeoutError
        return 0.25


class AtOnce(Executor):
    """Does what it is given before it returns."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        done: Future[Any] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except TimeoutError as error:
            done.set_exception(error)
        return done


def _asked(sender: Sender, correction: Correction, begin_s: int, end_s: int) -> int:
    before = sender.asked
    for half in range(2 * begin_s, 2 * end_s):
        correction.seconds(half / 2)
    return sender.asked - before


def test_one_that_hangs_is_asked_ever_less_and_keeps_its_last_answer() -> None:
    sender = Sender()
    correction = Correction(sender, AtOnce())
    assert _asked(sender, correction, 0, 60) == 12
    sender.hangs = True
    # Twenty such streams would else keep four threads at work for ever, a second each.
    assert _asked(sender, correction, 60, 660) <= 16
    assert correction.seconds(660) == 0.25
    sender.hangs = False
    _asked(sender, correction, 660, 760)
    assert _asked(sender, correction, 760, 820) == 12
