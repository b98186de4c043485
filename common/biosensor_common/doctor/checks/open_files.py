"""Checks how many LSL streams the system lets a program have."""

from __future__ import annotations

from collections.abc import Iterator

from biosensor_common import open_files
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, error, note, ok

ENOUGH = 100
"""Streams of about a dozen devices."""


def examine(context: Context) -> Iterator[Finding]:
    """Ask the system; this program has raised its own limit already, as the others do."""
    yield judge(open_files.limit(), context.streams_to_open)


def judge(limit: int | None, streams: int) -> Finding:
    """Judge a limit.

    Parameters
    ----------
    limit
        How many files a program may open; None where nothing is said.
    streams
        How many the settings ask for.
    """
    if limit is None:
        return ok("the system does not limit how many files a program opens")
    sent, received = (open_files.fitting(limit, each) for each in _EACH)
    what = (
        f"a program may open {limit} files, which is enough to send {sent} streams, or to "
        f"receive {received}"
    )
    if streams > sent:
        why = "Devices whose streams do not fit are left out."
        return error(f"{what}; the streams of the settings are {streams}", why, open_files.fix())
    if sent < ENOUGH:
        why = "Streams that do not fit are left out, of the agent and of the node."
        return note(what, why, open_files.fix())
    return ok(what)


_EACH = open_files.OUTLET, open_files.INLET
