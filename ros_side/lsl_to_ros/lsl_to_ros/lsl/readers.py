"""Assigns inlets to the threads that read them.

Streams without a subscriber to single samples share one thread, which drains them ten times
a second. Up to four of the other streams have a thread each that blocks until the next
sample, which has the least latency. More such threads would mostly wait for each other, so
then one thread polls all of these streams 500 times a second.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from lsl_to_ros.lsl.inlets import Inlet, InletState

DRAIN_PERIOD_S = 0.1
PEEK_PERIOD_S = 0.002
MOST_FOLLOWERS = 4


class Pump:
    """Keeps every inlet read.

    Parameters
    ----------
    inlets
        Returns the present inlets.
    """

    def __init__(self, inlets: Callable[[], Iterable[Inlet]]) -> None:
        self._inlets = inlets
        self._is_crowded = False
        self._read: list[Inlet] = []
        self._followers: dict[str, threading.Thread] = {}
        self._peeker: threading.Thread | None = None
        self._stopping = threading.Event()
        self._drainer = threading.Thread(target=self._drain, daemon=True, name="drain")
        self._drainer.start()

    def look(self) -> None:
        """Update which inlets are read sample by sample; call it often."""
        self._read = [
            inlet
            for inlet in self._inlets()
            if inlet.state is InletState.READY and inlet.wants_each_sample
        ]
        self._is_crowded = len(self._read) > MOST_FOLLOWERS
        if not self._is_crowded:
            self._follow()
        elif self._peeker is None or not self._peeker.is_alive():
            self._peeker = threading.Thread(target=self._peek, daemon=True, name="peek")
            self._peeker.start()

    def stop(self) -> None:
        """End the shared threads; the others end with their inlets."""
        self._stopping.set()
        self._drainer.join()
        if self._peeker is not None:
            self._peeker.join()

    def _follow(self) -> None:
        for uid in [uid for uid, thread in self._followers.items() if not thread.is_alive()]:
            del self._followers[uid]
        for inlet in self._read:
            if inlet.uid not in self._followers:
                thread = threading.Thread(
                    target=inlet.follow,
                    args=(lambda inlet=inlet: inlet.wants_each_sample and not self._is_crowded,),
                    daemon=True,
                    name=f"follow {inlet.core.name}",
                )
                self._followers[inlet.uid] = thread
                thread.start()

    def _peek(self) -> None:
        while self._is_crowded and not self._stopping.is_set():
            for inlet in self._read:
                inlet.peek()
            time.sleep(PEEK_PERIOD_S)

    def _drain(self) -> None:
        while not self._stopping.wait(DRAIN_PERIOD_S):
            for inlet in self._inlets():
                if inlet.state is InletState.READY:
                    inlet.drain()
