"""Says what is too much for the node, or for who reads a topic, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_common import open_files
from lsl_to_ros.accounts.load import LoadFacts
from lsl_to_ros.lsl.share import ALL, Share
from lsl_to_ros.parameters.node import MAX_PROCESSES, PROCESSES

_MOST_NAMED = 5


def overload(load: LoadFacts, process: Share = ALL) -> str:
    """Say what is too much for a process of the node; empty if it keeps up."""
    who, relief = name_of(process), _relief(process.of)
    share = "" if load.share is None else f"{100 * load.share:.0f} % of a core"
    if load.is_busy:
        waited = f", and data have waited {load.age_s:.1f} s in it" if load.age_s >= 0.1 else ""
        return f"{who} needs {share}{waited}: {relief}"
    if load.is_late:
        gets = f", which gets {share}" if share else ""
        return (
            f"data have waited {load.age_s:.1f} s in {who}{gets}: other programs keep this"
            f" computer busy; end some, or {relief}"
        )
    return ""


def crowded_out(streams: Sequence[str]) -> str:
    """Say which streams are left out because no more files may be opened; empty if none is."""
    if not streams:
        return ""
    named = ", ".join(streams[:_MOST_NAMED]) + ", ..." * (len(streams) > _MOST_NAMED)
    return str(open_files.exhausted(f"{len(streams)} streams are left out ({named})"))


def name_of(process: Share) -> str:
    """Name a process as users are told of it; the only one is the node."""
    return f"process {process.index} of {process.of}" if process.of > 1 else "the node"


def _relief(processes: int) -> str:
    more = min(2 * processes, MAX_PROCESSES)
    on_more_cores = f"start the node with {PROCESSES}:={more}, " * (more > processes)
    return (
        "read fast topics as _chunk or _stamped, switch streams off (Sensor_Enable),"
        f" {on_more_cores}or share the streams among nodes on several computers (stream_predicate)"
    )


def too_fast(rate: float, topics: Sequence[str], best_effort: Sequence[str]) -> str:
    """Say that a topic goes out faster than subscribers take it.

    Parameters
    ----------
    rate
        Messages of it in a second.
    topics
        Those that have the same samples in fewer messages.
    best_effort
        Nodes to which DDS sends nothing twice.
    """
    instead = f"; read {' or '.join(topics)} instead" if topics else ""
    unsafe = f"; {', '.join(best_effort)}: best effort, nothing is sent twice" * bool(best_effort)
    return (
        f"{rate:.0f} messages a second, more than a subscriber in Python takes, and no counter"
        f" of the node shows what its queue throws away{instead}{unsafe}"
    )


def not_taken(messages: int) -> str:
    """Say that a subscriber does not take what is published."""
    return (
        f"a subscriber stands still or is too slow: {messages} messages of a backlog in the last"
        " 10 s went out before it had taken those before, and it may lose some"
    )
