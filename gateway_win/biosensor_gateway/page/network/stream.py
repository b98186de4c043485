"""One stream of the network as this computer knows it."""

from __future__ import annotations

from dataclasses import dataclass, field

import pylsl

from biosensor_common.stream_header import CoreFields, StreamHeader
from biosensor_gateway.page.network.received import Received
from biosensor_gateway.page.network.receiver import Receiver

UNSEEN_S = 1.5
"""A resolver that has not reported a stream for so long has forgotten it."""
_DEAF_S = 2.0


def claim_of(core: CoreFields) -> tuple[str, str, str, str]:
    """Return what a stream is called by; one that has no source_id, on its computer alone."""
    return core.source_id, core.name, core.content_type, core.source_id or core.hostname


@dataclass(slots=True, eq=False)
class NetworkStream:
    """A stream, over all outlets that it had one after the other.

    Attributes
    ----------
    number
        By which the page knows it.
    info, core, uid
        What the newest outlet announces.
    seen_s
        Local LSL time at which a resolver reported that outlet last.
    header
        None while it is read for the first time.
    namesake
        Its number among live senders that claim to be one stream, from 1.
    note
        What is wrong with it, one sentence.
    has_description
        Whether the header of this outlet was read.
    lost_s
        Local LSL time at which its connection ended, while none is there again.
    """

    number: int
    info: pylsl.StreamInfo
    core: CoreFields
    uid: str
    seen_s: float
    header: StreamHeader | None = None
    namesake: int = 1
    note: str = ""
    has_description: bool = False
    lost_s: float | None = None
    receiver: Receiver | None = None
    received: Received = field(init=False)

    def __post_init__(self) -> None:
        self.received = Received(self.core)

    @property
    def is_ours(self) -> bool:
        """Whether an agent of ours sends it."""
        return self.header is not None and not self.header.foreign

    @property
    def claim(self) -> tuple[str, str, str, str]:
        """See `claim_of`."""
        return claim_of(self.core)

    def continues_as(self, core: CoreFields) -> bool:
        """Whether that announces this stream, come back.

        Our source_ids are unique. Other programs give one to several streams, or none.
        """
        own = self.core
        if (own.source_id, own.channel_count, own.format) != (
            core.source_id,
            core.channel_count,
            core.format,
        ):
            return False
        if self.is_ours:
            return True
        is_same = (own.name, own.content_type) == (core.name, core.content_type)
        return is_same and bool(core.source_id or own.hostname == core.hostname)

    def is_gone(self, now: float) -> bool:
        """Whether neither the resolver nor an inlet has it any more."""
        if self.lost_s is not None:
            return True
        heard_s = self.received.heard_s
        is_heard = self.receiver is not None and heard_s is not None and now - heard_s < _DEAF_S
        return now - self.seen_s > UNSEEN_S and not is_heard

    def follow(self, info: pylsl.StreamInfo, core: CoreFields, now: float) -> Receiver | None:
        """Go on with another outlet; return the inlet of the one before, to be closed."""
        self.info, self.core, self.uid, self.seen_s = info, core, info.uid(), now
        self.has_description, self.lost_s = False, None
        before, self.receiver = self.receiver, None
        return before
