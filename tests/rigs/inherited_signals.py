"""What a run under ``nohup`` or in the background passes on to the programs that tests start."""

from __future__ import annotations

import os
import signal
from types import FrameType


def let_programs_be_interrupted() -> None:
    """Give programs that tests start the default reaction to signals that this run ignores.

    ``nohup`` has SIGHUP ignored and a shell without job control SIGINT, and an ignored signal is
    inherited, also through ``exec``, so that a program cannot be asked to end by it. A handled one
    is back at its default after ``exec``; and as the handler does nothing, the run itself goes on
    as it was meant to, its workers included.
    """
    for name in ("SIGHUP", "SIGINT", "SIGQUIT"):
        number = getattr(signal, name, None)
        if number is None:
            continue
        # Workers start with what the main process passes on, which is the default.
        worker = name == "SIGHUP" and "PYTEST_XDIST_WORKER" in os.environ
        if worker or signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, _go_on)


def _go_on(_number: int, _frame: FrameType | None) -> None:
    pass
