"""Says what one number of a message is, as a channel of a stream."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from biosensor_common.ros_quantities import NOTHING_KNOWN, channel_type
from lsl_to_ros.ros_to_lsl.fields import Field


class Channel(NamedTuple):
    """One number of a message.

    Attributes
    ----------
    path
        Where it stands: ``position[0]``.
    label
        The same, with the element's name where it has one: ``panda_joint1.position``.
    values
        Names of its values, if the type enumerates them.
    """

    path: str
    label: str
    unit: str
    kind: str
    values: Mapping[int, str]
    is_wide: bool = False


def channel_of(field: Field, path: str, label: str) -> Channel:
    """Return the channel of a field, or of an element of one."""
    measured = field.measured
    kind = NOTHING_KNOWN.kind if measured is NOTHING_KNOWN else channel_type(measured, field.name)
    return Channel(path, label, measured.unit, kind, field.values, field.is_wide)
