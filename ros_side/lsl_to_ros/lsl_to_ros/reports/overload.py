"""Says what is too much for the node, or for who reads a topic, and what to do."""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_common import open_files
from lsl_to_ros.statistics.load import LoadFacts

_MOST_NAMED = 5
_RELIEF = (
    "read fast topics as _chunk or _stamped, switch streams off (Sensor_Enable), or share the"
    " streams among nodes on several computers (stream_predicate)"
)


def overload(load: LoadFacts) -> str:
    """Say what is too much for the node; empty if it keeps up."""
    share = "" if load.share is None else f"{100 * load.share:.0f} % of a core"
    if load.is_busy:
        waited = f", and data have waited {load.age_s:.1f} s in it" if load.age_s >= 0.1 else ""
        return f"the node needs {share}{waited}: {_RELIEF}"
    if load.is_late:
        gets = f", which gets {share}" if share else ""
        return (
            f"data have waited {load.age_s:.1f} s in the node{gets}: other programs keep this"
            f" computer busy; end some, or {_RELIEF}"
        )
    return ""


def crowded_out(streams: Sequence[str]) -> str:
    """Say which streams are left out because no more files may be opened; empty if none is."""
    if not streams:
        return ""
    named = ", ".join(streams[:_MOST_NAMED]) + ", ..." * (len(streams) > _MOST_NAMED)
    return str(open_files.exhausted(f"{len(streams)} streams are left out ({named})"))


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
