"""Gives what stands for hardware its time on a machine on which many tests run."""

from __future__ import annotations

import os
from contextlib import suppress

_PRIORITY = -10


def before_others(process: int = 0) -> None:
    """Let a process run before the others, where the system allows that (root).

    A sensor measures and a wire carries whatever the computers beside them do. Only so does a
    test that blames the product for what is late or lost not blame it for a busy machine.

    Parameters
    ----------
    process
        Its id; the caller's own by default. Threads and programs that it starts later inherit it.
    """
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, process, _PRIORITY)
