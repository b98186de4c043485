"""Reads the channels of a description; nothing in it is trusted."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

from biosensor_common.quantities import ChannelRole
from biosensor_common.stream_header import MAX_FIELD_CHARACTERS


class Channels(NamedTuple):
    """What a description says of the channels, in channel order.

    Attributes
    ----------
    labels, units
        Empty text where it says nothing.
    roles
        None where it says none, none that is known, or one in another unit.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    roles: tuple[ChannelRole | None, ...]


def read_channels(root: ET.Element, count: int) -> Channels:
    """Return what is said; nothing where the description has another number of channels."""
    nodes = root.findall("desc/channels/channel")
    if len(nodes) != count:
        blank = ("",) * count
        return Channels(blank, blank, (None,) * count)
    units = _texts(nodes, "unit")
    pairs = zip(_texts(nodes, "role"), units, strict=True)
    roles = tuple(_role(text, unit) for text, unit in pairs)
    return Channels(_texts(nodes, "label"), units, roles)


def _texts(nodes: Sequence[ET.Element], field: str) -> tuple[str, ...]:
    return tuple((node.findtext(field) or "")[:MAX_FIELD_CHARACTERS] for node in nodes)


def _role(text: str, unit: str) -> ChannelRole | None:
    try:
        role = ChannelRole(text)
    except ValueError:
        # None, or one of a later version.
        return None
    return role if role.unit == unit else None
