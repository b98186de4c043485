"""A virtual BioHarness that a test steers, and that notes what it says and hears."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, fields
from math import inf
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.devices.zephyr.simulator.bioharness import (
    BioHarness,
    Outgoing,
    Session,
    Source,
)
from biosensor_gateway.devices.zephyr.simulator.wire import WAVEFORMS, Packet, Request
from biosensor_gateway.devices.zephyr.simulator.zephyr import SyntheticSource
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import Clock

_T = TypeVar("_T")
ROOMY_BYTES = 1 << 20
"""For a test that must not lose a byte at high speed."""


@dataclass(frozen=True, eq=False)
class DamagedFrame(Outgoing):
    """A frame with a flipped bit: a host must not accept it."""


class SteeredBioHarness:
    """A `BioHarness` in a world of its own; a context manager.

    Parameters
    ----------
    source
        A wearer by default.
    seed
        Of garbage and flipped bits.
    buffer_bytes, tcp
        As for `BioHarness`.
    conversation
        Fields of the `Session`.
    """

    def __init__(
        self,
        source: Source | None = None,
        *,
        seed: int = 0,
        buffer_bytes: int = 4096,
        tcp: bool = False,
        refused: Iterable[int] = (),
        ignored: Iterable[int] = (),
        **conversation: Any,
    ) -> None:
        self._source = _Damaging(source or SyntheticSource(), seed)
        self._session = _NotedSession(refused=set(refused), ignored=set(ignored), **conversation)
        self._options: dict[str, Any] = {"seed": seed, "buffer_bytes": buffer_bytes, "tcp": tcp}
        self._sent: list[Outgoing] = []
        self._running: _Noted | None = None
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Make the port and switch the device on."""
        world = self._stack.enter_context(World())
        device = _Noted(world, self._source, self._session, **self._options)
        device.note = self._note
        self._running = self._stack.enter_context(device)
        self._port = device.port

    def stop(self) -> None:
        """Switch the device off and remove the port."""
        self._running = None
        self._stack.close()

    @property
    def port(self) -> str:
        """What a host opens; it stays the same over link drops."""
        return self._port

    @property
    def enabled(self) -> frozenset[Packet]:
        """The periodic packets that the host has switched on."""
        return self._ask(lambda: self._session.enabled)

    @property
    def requests(self) -> tuple[Request, ...]:
        """Every request heard, broken ones and lifesigns included, in order."""
        return self._ask(lambda: tuple(self._session.requests))

    @property
    def switched_on(self) -> frozenset[int]:
        """Requests whose last value was no zero: what a host that leaves would leave on."""
        last = {request.request_id: any(request.payload) for request in self.requests}
        return frozenset(request_id for request_id, is_on in last.items() if is_on)

    @property
    def sent(self) -> tuple[Outgoing, ...]:
        """Every frame of the source that the link took, in order.

        Answers, the conversation's lifesigns and garbage are not among them. Bytes that the
        host had not read when the link dropped were sent all the same, so at a drop this is
        more than what the host received. Never is it less.
        """
        return self._ask(lambda: tuple(self._sent))

    def sent_samples(self, packet: Packet) -> NDArray[np.int64]:
        """Return every sample of a waveform kind that was sent intact, in order.

        Returns
        -------
        ndarray of int64, shape (samples, 1 + channels)
            Number of the sample since power-on, then its values as `Inputs.samples` has
            them. Empty for a recording, whose frames are not decoded.
        """
        blocks = [np.empty((0, 1 + WAVEFORMS[packet].channels), np.int64)]
        for frame in self.sent:
            if frame.packet is packet and not is_damaged(frame) and frame.samples is not None:
                index = np.arange(len(frame.samples)) + (frame.first_index or 0)
                blocks.append(np.column_stack((index, frame.samples)))
        return np.concatenate(blocks)

    def drop_link(self, seconds: float = inf) -> None:
        """Hang up and be unreachable for ``seconds``, or until `restore_link`."""
        self._device.apply(Fault(FaultKind.DROP, seconds))

    def restore_link(self) -> None:
        """End a `drop_link` now; without effect on a link that is up."""
        self._device.clear(FaultKind.DROP)

    def stall(self) -> None:
        """Go out of reach with the link open: nothing is sent, nothing is heard."""
        self._device.apply(Fault(FaultKind.STALL, inf))

    def corrupt_next(self) -> None:
        """Flip one bit in the payload or check of the source's next frame."""
        self._ask(self._source.damage_next)

    def step_clock(self, seconds: float) -> None:
        """Set the device's clock forward or back; not for a recording."""
        self._ask(lambda: self._body.step_clock(round(1000 * seconds)))

    def midnight(self, seconds: float = 1.0) -> None:
        """Set the clock so many device seconds before midnight; not for a recording."""
        self._ask(lambda: self._body.midnight_in(round(1000 * seconds)))

    @property
    def _device(self) -> BioHarness:
        assert self._running is not None, "the device is not switched on"
        return self._running

    @property
    def _body(self) -> SyntheticSource:
        assert isinstance(self._source.inner, SyntheticSource), "a recording cannot be changed"
        return self._source.inner

    def _note(self, frame: Outgoing, sent: bool) -> None:
        if sent:
            self._sent.append(frame)

    def _ask(self, function: Callable[[], _T]) -> _T:
        return function() if self._running is None else self._running.world.call(function)


def is_damaged(frame: Outgoing) -> bool:
    """Whether `SteeredBioHarness.corrupt_next` hit it."""
    return isinstance(frame, DamagedFrame)


class _Noted(BioHarness):
    note: Callable[[Outgoing, bool], None]

    def _note(self, frame: Outgoing, *, sent: bool) -> None:
        self.note(frame, sent)


class _NotedSession(Session):
    def __init__(self, **conversation: Any) -> None:
        self.requests: list[Request] = []
        super().__init__(**conversation)

    def hear(self, data: bytes, now: float) -> list[Request]:
        requests = super().hear(data, now)
        self.requests += requests
        return requests


class _Damaging:
    """A source whose next frame gets a flipped bit when it is told."""

    def __init__(self, inner: Source, seed: int) -> None:
        self.inner = inner
        self._rng = np.random.default_rng(seed)
        self._damages_next = False

    @property
    def speaks_lifesigns(self) -> bool:
        return self.inner.speaks_lifesigns

    def damage_next(self) -> None:
        self._damages_next = True

    def power_on(self, clock: Clock) -> None:
        self.inner.power_on(clock)

    def poll(self, now: float, enabled: frozenset[Packet]) -> list[Outgoing]:
        frames = list(self.inner.poll(now, enabled))
        if frames and self._damages_next:
            self._damages_next = False
            frames[0] = self._damaged(frames[0])
        return frames

    def next_due(self) -> float:
        return self.inner.next_due()

    def hangs_up(self, now: float) -> bool:
        return self.inner.hangs_up(now)

    def connection_ended(self) -> None:
        self.inner.connection_ended()

    def _damaged(self, frame: Outgoing) -> DamagedFrame:
        # Id and length are outside the check: a flip there might pass for another frame.
        first, last = 3, len(frame.data) - 2
        bit = int(self._rng.integers(8 * first, 8 * (last + 1)))
        damaged = bytearray(frame.data)
        damaged[bit // 8] ^= 1 << bit % 8
        content: dict[str, Any] = {each.name: getattr(frame, each.name) for each in fields(frame)}
        content["data"] = bytes(damaged)
        return DamagedFrame(**content)
