"""Collects which streams there are, for the name of a topic depends on all of them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import StreamHeader


@dataclass(frozen=True, slots=True)
class Claim:
    """What one stream wants to be called by.

    Attributes
    ----------
    chunk
        Data name of its chunks, empty without any.
    is_lasting
        Whether the name stays with the device when that is gone.
    """

    identity: DeviceIdentity
    data_name: str
    chunk: str
    is_lasting: bool


class Names(Protocol):
    """What the streams of one process are named by."""

    def claim(self, own: Mapping[str, Claim]) -> None:
        """Say which streams this process has, by their uid."""
        ...

    @property
    def claims(self) -> Mapping[str, Claim]:
        """Those of all processes; one that is not among them yet has to wait for its name."""
        ...

    @property
    def lasting(self) -> frozenset[DeviceIdentity]:
        """Devices that keep their names: another one's data must not appear under them."""
        ...


class Register:
    """The streams of all processes, in the first of them.

    Attributes
    ----------
    version
        Another one after each change.
    """

    def __init__(self) -> None:
        self.version = 0
        self._parts: dict[int, Mapping[str, Claim]] = {}
        self._claims: dict[str, Claim] = {}
        self._lasting: frozenset[DeviceIdentity] = frozenset()

    @property
    def claims(self) -> Mapping[str, Claim]:
        """As :class:`Names` has it."""
        return self._claims

    @property
    def lasting(self) -> frozenset[DeviceIdentity]:
        """As :class:`Names` has it."""
        return self._lasting

    def claim(self, own: Mapping[str, Claim]) -> None:
        """Take in what the first process itself has."""
        self.put(0, own)

    def put(self, index: int, claims: Mapping[str, Claim]) -> None:
        """Take in what a process has now."""
        if claims == self._parts.get(index, {}):
            return  # nothing is dropped: they are known
        self.version += 1
        self._parts[index] = dict(claims)
        self._claims = {uid: claim for part in self._parts.values() for uid, claim in part.items()}
        found = {claim.identity for claim in claims.values() if claim.is_lasting}
        self._lasting |= found


def claim_of(header: StreamHeader) -> Claim:
    """Return what a stream claims."""
    return Claim(header.identity, header.data_name, header.chunk, _is_named_after_unit(header))


def renamed(header: StreamHeader, lsl_name: str, aliases: Mapping[str, str]) -> StreamHeader:
    """Return the header of a stream under the name that the user has for it, if there is one.

    Streams of agents keep their names: label and participant are set where they are.

    Parameters
    ----------
    aliases
        Names of sensors by those of LSL streams; in these, ``*`` is any text. The first one holds.
    """
    for pattern, alias in aliases.items():
        texts = map(re.escape, pattern.split("*"))
        if header.foreign and re.fullmatch(".*".join(texts), lsl_name, re.DOTALL):
            return replace(header, identity=replace(header.identity, sensor=alias))
    return header


def _is_named_after_unit(header: StreamHeader) -> bool:
    """Whether the name stands for one device for good.

    A participant or a label names a place, where a device may be replaced, and
    another program may give its stream a new source_id at every start.
    """
    identity = header.identity
    return not (header.foreign or identity.participant or identity.label)
