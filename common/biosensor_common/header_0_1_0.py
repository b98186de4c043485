"""Infers from LSL type, label and unit what the headers of version 0.1.0 leave unsaid.

An agent of 0.1.0, and a recording of it, says neither the role of a channel nor
whether a stream shows a state. Later agents say both, and nothing is inferred then.
"""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_common.quantities import (
    ACCELERATION,
    MAGNETIC_FIELD,
    ORIENTATION,
    ChannelRole,
    ContentType,
)

_STATES = frozenset({ContentType.BATTERY, ContentType.RSSI, ContentType.STATUS})
_OF_TYPE = {
    ContentType.BATTERY: ChannelRole.STATE_OF_CHARGE,
    ContentType.RSSI: ChannelRole.SIGNAL_STRENGTH,
}
_OF_LABEL: dict[ContentType, dict[str, ChannelRole]] = {
    ContentType.QUALITY: dict.fromkeys(("contact", "electrodes", "worn"), ChannelRole.CONTACT),
    ContentType.STATUS: {"BatteryPercent": ChannelRole.STATE_OF_CHARGE},
    ContentType.MOCAP: dict(
        zip(
            ("Q0", "Q1", "Q2", "Q3", "ACCX", "ACCY", "ACCZ", "MAGX", "MAGY", "MAGZ"),
            (*ORIENTATION, *ACCELERATION, *MAGNETIC_FIELD),
            strict=True,
        )
    ),
}


def inferred_roles(content_type: str, labels: Sequence[str]) -> tuple[ChannelRole | None, ...]:
    """Return the role of each channel, None for most; the units may contradict it."""
    try:
        known = ContentType(content_type)
    except ValueError:
        return (None,) * len(labels)
    of_label = _OF_LABEL.get(known, {})
    return tuple(of_label.get(label, _OF_TYPE.get(known)) for label in labels)


def inferred_state(content_type: str, rate: float) -> bool:
    """Return whether the stream shows a state."""
    return content_type in _STATES and rate == 0
