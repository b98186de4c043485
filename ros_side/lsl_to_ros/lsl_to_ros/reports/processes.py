"""Sums up the processes of the node for ``/diagnostics``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pylsl
from diagnostic_msgs.msg import DiagnosticStatus

from lsl_to_ros.lsl.share import Share
from lsl_to_ros.reports.diagnostics import status
from lsl_to_ros.reports.overload import crowded_out, overload
from lsl_to_ros.reports.survey import Concern, Part

_MOST_NAMED = 5
COMPUTER_BUSY = "computer_busy"
"""Whether other programs keep data waiting in the node, ``true`` or ``false``."""


@dataclass(frozen=True, slots=True)
class ProcessFacts:
    """One look at a process.

    Attributes
    ----------
    pid
        0 while it does not run.
    part
        What it reported last; None before.
    trouble
        What is or was wrong with it lately; empty if nothing was.
    is_gone
        Whether it does not do its work now.
    restarts
        How often it was started again.
    """

    share: Share
    pid: int
    part: Part | None
    trouble: str = ""
    is_gone: bool = False
    restarts: int = 0

    @property
    def statuses(self) -> Sequence[DiagnosticStatus]:
        """Of its streams; those that it had while it is gone."""
        return self._as_they_are(self.part.statuses) if self.part else []

    @property
    def devices(self) -> Sequence[DiagnosticStatus]:
        """Of the devices of these streams."""
        return self._as_they_are(self.part.devices) if self.part else []

    def _as_they_are(self, statuses: Sequence[DiagnosticStatus]) -> Sequence[DiagnosticStatus]:
        return [_stale(each, self.trouble) for each in statuses] if self.is_gone else statuses


def node_status(
    processes: Sequence[ProcessFacts], values: Mapping[str, str], concerns: Sequence[Concern]
) -> DiagnosticStatus:
    """Describe the node: sums over all processes, the longest wait of any, and each trouble.

    Parameters
    ----------
    values
        What concerns the node as a whole.
    concerns
        What is wrong with the node as a whole.
    """
    parts = [each.part for each in processes if each.part is not None and not each.is_gone]
    streams = sum(part.streams for part in parts)
    shares = [part.load.share for part in parts if part.load.share is not None]
    facts = {
        "cpu_percent": f"{100 * sum(shares):.0f}" if len(shares) == len(parts) else "",
        "queue_age_s": f"{max(part.load.age_s for part in parts):.3f}",
        COMPUTER_BUSY: str(any(part.load.is_late for part in parts)).lower(),
        "streams": str(streams),
        "streams_refused": str(sum(part.refused for part in parts)),
        "streams_left_out": str(sum(len(part.crowded_out) for part in parts)),
        **values,
        "liblsl": str(pylsl.library_version()),
        "processes": str(len(processes)),
    }
    judged = [_judge(each) for each in processes]
    level = max([level for level, _ in judged] + [bytes([each.level]) for each in concerns])
    told = [*(reason for _, reason in judged), *(each.text for each in concerns)]
    reasons = [reason for reason in told if reason]
    return status("node", level, "; ".join(reasons) or f"{streams} streams", facts)


def process_status(facts: ProcessFacts) -> DiagnosticStatus:
    """Describe one of several processes."""
    level, reason = _judge(facts)
    part = facts.part
    share = part.load.share if part else None
    values = {
        "cpu_percent": "" if share is None else f"{100 * share:.0f}",
        "queue_age_s": f"{part.load.age_s:.3f}" if part else "",
        "streams": str(part.streams) if part else "",
        "restarts": str(facts.restarts),
        "pid": str(facts.pid or ""),
    }
    message = reason or f"{values['streams'] or 'no'} streams"
    return status(f"process {facts.share.index}", level, message, values)


def _judge(facts: ProcessFacts) -> tuple[bytes, str]:
    if facts.is_gone:
        return DiagnosticStatus.ERROR, facts.trouble
    load = facts.part.load if facts.part else None
    too_much = overload(load, facts.share) if load else ""
    left_out = crowded_out(facts.part.crowded_out) if facts.part else ""
    reasons = [each for each in (too_much, left_out, facts.trouble) if each]
    concerns = facts.part.concerns if facts.part else ()
    level = max([int(bool(reasons)), *(each.level for each in concerns)])
    named = [each.text for each in concerns[:_MOST_NAMED]]
    more = [f"and {len(concerns) - len(named)} more"] * (len(concerns) > len(named))
    return bytes([level]), "; ".join([*reasons, *named, *more])


def _stale(entry: DiagnosticStatus, trouble: str) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=DiagnosticStatus.STALE,
        name=entry.name,
        message=trouble,
        hardware_id=entry.hardware_id,
        values=entry.values,
    )
