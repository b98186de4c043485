"""What pylsl alone costs: a process that receives and does nothing else.

``python -m benchmarks.lsl_receiver read STREAMS COUNT FILE`` or ``... drain STREAMS``
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import pylsl

from benchmarks.child import Orders, say
from benchmarks.samples import CONTENT_TYPE, Arrivals, stream_names

DRAIN_PERIOD_S = 0.1
_RESOLVE_S = 30.0
_PULL_S = 0.2
_POLL_S = 0.1


def read(streams: int, count: int, file: Path) -> None:
    """Pull by a call that blocks until the next sample, in a thread for each inlet."""
    orders, arrivals = Orders(), Arrivals(streams, count)
    here = threading.Barrier(streams + 1)
    threads = [
        threading.Thread(target=_read_one, args=(inlet, index, arrivals, orders, here))
        for index, inlet in enumerate(_inlets(streams))
    ]
    for thread in threads:
        thread.start()
    here.wait()
    say("connected")
    while not orders.closed.wait(_POLL_S):
        if arrivals.is_complete:
            say("complete")
            orders.closed.wait()
    for thread in threads:
        thread.join()
    arrivals.write(file)
    say(f"repeated {arrivals.repeated}")


def _read_one(
    inlet: pylsl.StreamInlet,
    index: int,
    arrivals: Arrivals,
    orders: Orders,
    here: threading.Barrier,
) -> None:
    inlet.pull_sample(_RESOLVE_S)
    here.wait()
    while not orders.closed.is_set():
        sample, _stamp = inlet.pull_sample(_PULL_S)
        if sample is not None:
            arrivals.add(index, sample[0])


def drain(streams: int) -> None:
    """Take what is there from all inlets, ten times a second; say how much at an order."""
    orders, inlets, drained = Orders(), _inlets(streams), 0
    for inlet in inlets:
        inlet.pull_sample(_RESOLVE_S)
    say("connected")
    due = time.monotonic()
    while not orders.closed.is_set():
        due += DRAIN_PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))
        for inlet in inlets:
            samples, _stamps = inlet.pull_chunk(timeout=0.0)
            drained += len(samples)
        if orders.poll() is not None:
            say(f"drained {drained}")


def _inlets(streams: int) -> list[pylsl.StreamInlet]:
    """Open one inlet a stream, in the order of their names."""
    names = stream_names(streams)
    found = pylsl.resolve_byprop("type", CONTENT_TYPE, minimum=streams, timeout=_RESOLVE_S)
    infos = {info.name(): info for info in found}
    return [pylsl.StreamInlet(infos[name], recover=False) for name in names]


if __name__ == "__main__":
    if sys.argv[1] == "read":
        read(int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
    else:
        drain(int(sys.argv[2]))
