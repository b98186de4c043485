"""Reads the channels of a description; nothing in it is trusted."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

from biosensor_common.quantities import ChannelRole
from biosensor_common.stream_header import MAX_FIELD_CHARACTERS

Roles = tuple[ChannelRole | None, ...]


class Channels(NamedTuple):
    """What a description says of the channels, in channel order.

    Attributes
    ----------
    labels, units
        Empty text where it says nothing.
    roles
        None where it says none, none that is known, or one in another unit.
    says_roles
        Whether it names a role at all, known or not.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    roles: Roles
    says_roles: bool


def read_channels(root: ET.Element, count: int) -> Channels:
    """Return what is said; nothing where the description has another number of channels."""
    nodes = root.findall("desc/channels/channel")
    if len(nodes) != count:
        blank = ("",) * count
        return Channels(blank, blank, (None,) * count, says_roles=False)
    units = _texts(nodes, "unit")
    roles = _texts(nodes, "role")
    return Channels(
        _texts(nodes, "label"), units, fitting(tuple(map(_role, roles)), units), any(roles)
    )


def fitting(roles: Roles, units: Sequence[str]) -> Roles:
    """Return the roles without those whose channel has another unit."""
    pairs = zip(roles, units, strict=True)
    return tuple(role if role is not None and role.unit == unit else None for role, unit in pairs)


def _texts(nodes: Sequence[ET.Element], field: str) -> tuple[str, ...]:
    return tuple((node.findtext(field) or "")[:MAX_FIELD_CHARACTERS] for node in nodes)


def _role(text: str) -> ChannelRole | None:
    try:
        return ChannelRole(text)
    except ValueError:
        # None, or one of a later version.
        return None
