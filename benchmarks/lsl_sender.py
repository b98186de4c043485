"""A process with LSL outlets: ``python -m benchmarks.lsl_sender OFFER``, an `Offer` as JSON."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray

from benchmarks.child import Orders, say
from benchmarks.samples import CHANNELS, CONTENT_TYPE, FILLER, RATE_HZ, values_of
from benchmarks.schedule import Schedule

# pylsl.transp_sync_blocking: a push writes to the socket itself.
_SYNCHRONOUS = 4


@dataclass(frozen=True, slots=True)
class Offer:
    """What one process sends."""

    names: Sequence[str]  # Of the streams.
    rate_hz: float = RATE_HZ
    source_id: str | None = None  # Of the only stream; None: each stream's is its name.
    offset_s: float = 0.0  # Delay of the first stream within a period.
    filler: float = FILLER  # What is in channel 0 while no sample counts.
    # Whether all streams are sent at once and without a thread for each, which costs a quarter of
    # the CPU. The receiver sees the same packets.
    frugal: bool = False
    block: int = 1  # Samples that are pushed at once, as a radio brings them, when the last is due.

    def as_arguments(self) -> list[str]:
        """Return the arguments that start the process."""
        return ["benchmarks.lsl_sender", json.dumps(asdict(self))]


def _outlet(name: str, offer: Offer) -> pylsl.StreamOutlet:
    source_id = name if offer.source_id is None else offer.source_id
    shape = CHANNELS, offer.rate_hz, "float32"
    info = pylsl.StreamInfo(name, CONTENT_TYPE, *shape, source_id)
    make: Any = pylsl.StreamOutlet
    return make(info, transport_flags=_SYNCHRONOUS if offer.frugal else 0)


def send(offer: Offer) -> None:
    """Offer the streams, say ``up`` and when, and push sample by sample, or block by block.

    The stamps are those of a device that measures on time. On Linux, LSL's clock is the
    monotonic one. With the time of the push instead, a sender that was held up by other
    load would seem to have a gap.
    """
    orders = Orders()
    outlets = [_outlet(name, offer) for name in offer.names]
    say(f"up {time.monotonic()}")
    if offer.block > 1:
        _send_blocks(offer, outlets, orders)
        return
    pushes = [outlet.push_sample for outlet in outlets]
    schedule = Schedule(
        values_of, pushes, offer.rate_hz, offer.offset_s, offer.filler, together=offer.frugal
    )
    schedule.run(orders)


def _send_blocks(offer: Offer, outlets: Sequence[pylsl.StreamOutlet], orders: Orders) -> None:
    """Send by the schedule a block for each of its numbers."""
    ahead_s = (offer.block - 1 - np.arange(offer.block)) / offer.rate_hz
    values = np.tile(np.asarray(values_of(0.0), np.float32), (offer.block, 1))

    def block_of(number: float) -> NDArray[np.float32]:
        counts = number >= 0
        values[:, 0] = number * offer.block + np.arange(offer.block) if counts else number
        return values

    def push_to(outlet: pylsl.StreamOutlet, block: NDArray[np.float32], due: float) -> None:
        outlet.push_chunk(block, list(due - ahead_s))

    pushes = [partial(push_to, outlet) for outlet in outlets]
    rate_hz = offer.rate_hz / offer.block
    Schedule(block_of, pushes, rate_hz, offer.offset_s, offer.filler, together=offer.frugal).run(
        orders
    )


if __name__ == "__main__":
    send(Offer(**json.loads(sys.argv[1])))
