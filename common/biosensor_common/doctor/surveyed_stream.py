"""The record of a stream as this computer sees it."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(slots=True)
class SurveyedStream:
    """One stream.

    Attributes
    ----------
    ports
        Of its data and of its service.
    offset_s
        What its clock must be corrected by, in s; None if that could not be measured.
    round_trip_s
        Of the best measurement.
    stamp_error_s
        Corrected stamp of a fresh sample minus the time of its arrival, in s; None if no
        sample came.
    data_port
        TCP port of its data over IPv4; 0 if it has none.
    session
        LSL's, in which it is.
    """

    name: str
    source_id: str
    uid: str
    host: str
    format: str
    ports: list[int] = field(default_factory=list[int])
    offset_s: float | None = None
    round_trip_s: float | None = None
    stamp_error_s: float | None = None
    data_port: int = 0
    session: str = ""
