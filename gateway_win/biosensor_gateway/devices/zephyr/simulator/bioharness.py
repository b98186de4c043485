"""A virtual BioHarness 3 that speaks the vendor's protocol on a serial port.

::

    with SimulatedBioHarness(SyntheticSource(seed=1)) as device:
        serial.Serial(device.port, 115200)

A pseudo-terminal does not tell that a host opened or closed it. So the device says
nothing before the host's first byte, and notices a host that left without a word
only by its silence.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from math import inf
from queue import SimpleQueue
from types import TracebackType
from typing import Self

import numpy as np

from biosensor_gateway.devices.zephyr.simulator.body import Integers
from biosensor_gateway.devices.zephyr.simulator.device import PutOnLink, SimulatedDevice
from biosensor_gateway.devices.zephyr.simulator.session import Session
from biosensor_gateway.devices.zephyr.simulator.sources import Outgoing, Source, SyntheticSource
from biosensor_gateway.devices.zephyr.simulator.wire import WAVEFORMS, Packet, Request
from biosensor_gateway.simulation.serial_links import Link, PtyLink
from biosensor_gateway.simulation.tcp_link import TcpHostLink

_ORDER_TIMEOUT_S = 10.0


class SimulatedBioHarness:
    """The device: a source of packets, a conversation and a link, with faults.

    One thread owns all state; the methods hand it their orders and return when
    they are carried out. What was sent can be asked for at any time.

    Parameters
    ----------
    source
        `SyntheticSource` (default) or a recording.
    link
        Where the host is; a pseudo-terminal by default, TCP on Windows.
    summary_supported
        False: an old device, which refuses 0xBD and has general data (0x20) instead.
    host_timeout_s
        A host that is silent for so long is forgotten with its enables; None = never.
    lifesign_s
        Between two lifesigns.
    answer_delay_s, refused, ignored
        Faults to begin with, as `delay_answers`, `refuse` and `ignore` set them.
    seed
        Of garbage and flipped bits.
    kept_packets
        How many of the last sent packets and requests are kept for `sent` and
        `requests`; None = all, which is for tests and not for days of running.
    put_on_link
        See `SimulatedDevice`.
    """

    def __init__(
        self,
        source: Source | None = None,
        *,
        link: Link | None = None,
        summary_supported: bool = True,
        host_timeout_s: float | None = 10.0,
        lifesign_s: float = 3.0,
        answer_delay_s: float = 0.0,
        refused: Iterable[int] = (),
        ignored: Iterable[int] = (),
        seed: int = 0,
        kept_packets: int | None = None,
        put_on_link: PutOnLink | None = None,
    ) -> None:
        session = Session(
            summary_supported,
            host_timeout_s,
            lifesign_s,
            answer_delay_s,
            set(refused),
            set(ignored),
        )
        self._device = SimulatedDevice(
            source or SyntheticSource(),
            session,
            link or _usual_link(),
            seed,
            kept_packets,
            put_on_link,
        )
        self._stopping = False
        self._orders: SimpleQueue[tuple[Callable[[], None], Future[None]]] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="virtual BioHarness", daemon=True)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    @property
    def port(self) -> str:
        """What a host opens; it stays the same over link drops."""
        return self._device.link.port

    @property
    def enabled(self) -> frozenset[Packet]:
        """The periodic packets that the host has switched on."""
        return self._device.session.enabled

    @property
    def requests(self) -> tuple[Request, ...]:
        """Every request heard, broken ones and lifesigns included, in order."""
        return tuple(self._device.requests.copy())

    @property
    def sent(self) -> tuple[Outgoing, ...]:
        """Every frame of the source that the link took, in order.

        Answers, the conversation's lifesigns and garbage are not among them. Bytes
        that the host had not read when the link dropped were sent all the same, so
        at a drop this is more than what the host received. Never is it less: what a
        host has read is among them.
        """
        sent: list[Outgoing] = []
        # Between two steps: a frame is recorded only after its bytes are on the link.
        self.carry_out(lambda: sent.extend(self._device.sent))
        return tuple(sent)

    @property
    def dropped_frames(self) -> int:
        """Frames that the link had no room for, because the host did not read."""
        return self._device.dropped_frames

    def sent_samples(self, packet: Packet) -> Integers:
        """Return every sample of a waveform kind that was sent intact, in order.

        Returns
        -------
        ndarray of int64, shape (samples, 1 + channels)
            Number of the sample since power-on, then its values as `Body.samples`
            has them. Empty for a recording, whose frames are not decoded.
        """
        blocks = [np.empty((0, 1 + WAVEFORMS[packet].channels), np.int64)]
        for frame in self.sent:
            if frame.packet is packet and not frame.corrupted and frame.samples is not None:
                index = np.arange(len(frame.samples)) + (frame.first_index or 0)
                blocks.append(np.column_stack((index, frame.samples)))
        return np.concatenate(blocks)

    def start(self) -> None:
        """Make the port and switch the device on.

        Raises
        ------
        TransportError
            UNAVAILABLE if this system has no pseudo-terminals.
        """
        self._device.power_on()
        self._thread.start()

    def stop(self) -> None:
        """Switch the device off and remove the port; also for one that was never started."""

        def order() -> None:
            self._stopping = True

        if self._thread.is_alive():
            self.carry_out(order)
            self._thread.join()
        self._device.link.dispose()

    def drop_link(self, seconds: float = inf) -> None:
        """Hang up and be unreachable for ``seconds``, or until `restore_link`."""
        self.carry_out(lambda: self._device.hang_up(seconds))

    def restore_link(self) -> None:
        """End a `drop_link` now; without effect on a link that is up."""
        self.carry_out(self._device.restore)

    def stall(self) -> None:
        """Go out of reach with the link open: nothing is sent, nothing is heard."""
        self._set_stalled(True)

    def resume(self) -> None:
        """End a `stall`; what was measured meanwhile is missing."""
        self._set_stalled(False)

    def forget_enables(self) -> None:
        """Send lifesigns only, until the host enables packets again."""
        self.carry_out(self._device.session.forget_enables)

    def garbage(self, count: int) -> None:
        """Send so many random bytes between two frames."""
        self.carry_out(lambda: self._device.send_garbage(count))

    def corrupt_next(self) -> None:
        """Flip one bit in the payload or check of the next frame."""

        def order() -> None:
            self._device.corrupts_next = True

        self.carry_out(order)

    def refuse(self, request_id: int) -> None:
        """Answer this request with NAK until `allow`."""
        self.carry_out(lambda: self._device.session.refused.add(request_id))

    def ignore(self, request_id: int) -> None:
        """Leave this request without an answer until `allow`."""
        self.carry_out(lambda: self._device.session.ignored.add(request_id))

    def allow(self, request_id: int) -> None:
        """End `refuse` and `ignore` of this request."""

        def order() -> None:
            self._device.session.refused.discard(request_id)
            self._device.session.ignored.discard(request_id)

        self.carry_out(order)

    def delay_answers(self, seconds: float) -> None:
        """Answer every request so much later; 0 ends it."""

        def order() -> None:
            self._device.session.answer_delay_s = seconds

        self.carry_out(order)

    def off_body(self) -> None:
        """Take the strap off: status, vitals and event; not for a recording."""
        self.carry_out(lambda: self._synthetic.set_worn(False))

    def on_body(self) -> None:
        """Put the strap on again; not for a recording."""
        self.carry_out(lambda: self._synthetic.set_worn(True))

    def battery(self, percent: int) -> None:
        """Set the battery's charge [percent]; not for a recording."""
        self.carry_out(lambda: self._synthetic.set_battery(percent))

    def event(self, code: int, data: bytes = b"") -> None:
        """Have an event happen (0x0040 is the button); not for a recording."""
        self.carry_out(lambda: self._synthetic.add_event(code, data))

    def step_clock(self, seconds: float) -> None:
        """Set the device's clock forward or back; not for a recording."""
        self.carry_out(lambda: self._synthetic.step_clock(round(1000 * seconds)))

    def midnight(self, seconds: float = 1.0) -> None:
        """Set the clock so many device seconds before midnight; not for a recording."""
        self.carry_out(lambda: self._synthetic.midnight_in(round(1000 * seconds), time.monotonic()))

    def carry_out(self, order: Callable[[], None]) -> None:
        """Run ``order`` in the device's thread and wait for it; raise what it raises."""
        if not self._thread.is_alive():
            order()
            return
        outcome: Future[None] = Future()
        self._orders.put((order, outcome))
        self._device.link.wake()
        outcome.result(_ORDER_TIMEOUT_S)

    @property
    def _synthetic(self) -> SyntheticSource:
        if not isinstance(self._device.source, SyntheticSource):
            raise TypeError("a recording's body and clock cannot be changed")
        return self._device.source

    def _set_stalled(self, stalled: bool) -> None:
        def order() -> None:
            self._device.stalled = stalled

        self.carry_out(order)

    def _run(self) -> None:
        while not self._stopping:
            heard = self._device.wait()
            self._obey_orders()
            self._device.step(heard)

    def _obey_orders(self) -> None:
        while not self._orders.empty():
            order, outcome = self._orders.get()
            try:
                order()
            except Exception as error:  # noqa: BLE001 - whoever gave the order gets its error
                outcome.set_exception(error)
            else:
                outcome.set_result(None)


def _usual_link() -> Link:
    # Windows has no pseudo-terminals.
    return TcpHostLink() if sys.platform == "win32" else PtyLink()
