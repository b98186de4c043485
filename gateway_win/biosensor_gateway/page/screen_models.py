"""Streams as a screen shows them."""

from __future__ import annotations

from pydantic import BaseModel


class ScreenStream(BaseModel):
    """What a screen shows of a stream, of whichever program.

    Attributes
    ----------
    source_id, lsl_name, topic
        Its names for programs, for LabRecorder, and in ROS with the usual prefix.
    measured_hz
        Over the last seconds, by the samples' own times; None while nothing comes, and for
        streams that come when they come.
    age_s
        Of the newest sample; None before the first.
    is_fresh
        Whether the newest values are those of now; a stale value is not shown.
    is_signal
        Whether it was measured on the body: not a battery, a radio or a counter.
    values
        Newest values by channel; empty when they are stale, and for text.
    """

    source_id: str
    data_name: str
    lsl_name: str
    topic: str
    content_type: str
    channels: list[str]
    units: list[str]
    measured_hz: float | None
    age_s: float | None
    is_fresh: bool
    is_signal: bool
    values: list[float | None]
