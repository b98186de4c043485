"""Joins what several processes tell of one device."""

from __future__ import annotations

from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticStatus


def merged(statuses: Iterable[DiagnosticStatus]) -> list[DiagnosticStatus]:
    """Return one entry for each name: the values of all, and the worst level with its reason.

    The streams of a device may be in several processes, and each of these tells of it what its
    own streams say.
    """
    by_name: dict[str, DiagnosticStatus] = {}
    for status in statuses:
        other = by_name.get(status.name)
        by_name[status.name] = status if other is None else _joined(other, status)
    return list(by_name.values())


def _joined(first: DiagnosticStatus, second: DiagnosticStatus) -> DiagnosticStatus:
    worse = second if second.level > first.level else first
    values = {value.key: value for value in (*first.values, *second.values)}
    return DiagnosticStatus(
        level=worse.level,
        name=first.name,
        message=worse.message,
        hardware_id=first.hardware_id or second.hardware_id,
        values=list(values.values()),
    )
