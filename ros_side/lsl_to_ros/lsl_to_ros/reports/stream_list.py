"""Builds ``~/streams``: which LSL stream fills which topics, latched, anew at each change."""

from __future__ import annotations

from collections.abc import Iterable

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from lsl_to_ros.routing import Route


def stream_list(routes: Iterable[Route]) -> list[DiagnosticStatus]:
    """Return a status a stream, named by its raw topic, its facts as values."""
    return [_entry(route) for route in routes if route.bridge is not None]


def _entry(route: Route) -> DiagnosticStatus:
    assert route.bridge is not None
    header, core = route.header, route.inlet.core
    publishers = route.bridge.outputs.publishers
    values = {
        "lsl_name": core.name,
        "lsl_type": core.content_type,
        "source_id": core.source_id,
        "uid": route.inlet.uid,
        "host": core.hostname,
        "rate": f"{header.rate:g}",
        "format": header.format.value,
        "labels": ", ".join(header.labels),
        "units": ", ".join(header.units),
        "participant": header.identity.participant,
        "label": header.identity.label,
        "foreign": str(header.foreign).lower(),
        **{f"topic {publisher.name}": publisher.type_name for publisher in publishers},
    }
    return DiagnosticStatus(
        level=DiagnosticStatus.OK,
        name=publishers[0].name,
        message=f"{core.name} of {core.hostname}",
        hardware_id=header.identity.unit,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
