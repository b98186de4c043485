"""Makes inlets that wait for nothing without a limit and go on with no other outlet.

The first pull of an inlet that was never opened waits for its outlet as long as liblsl recovers
lost streams, for ever if the outlet is gone. And liblsl recovers by name, type and source_id
alone: it goes on with an outlet of another session or with another header. So liblsl never
recovers here. Whoever lost a stream looks for it again, by a resolver of the own session, and
reads its header again.
"""

from __future__ import annotations

import pylsl
import pylsl.util

LAST_ENTRY_S = 0.1
"""From a loss until the last entry of the queue is surely there, see `undelivered`."""


def unopened_inlet(
    info: pylsl.StreamInfo, max_buflen: int = 1, *, as_numpy: bool = False
) -> pylsl.StreamInlet:
    """Return an inlet that asks for a header or a clock; to be opened with a limit before a pull.

    Raises
    ------
    RuntimeError
        If liblsl cannot make it.
    """
    return pylsl.StreamInlet(info, max_buflen=max_buflen, recover=False, as_numpy=as_numpy)


def open_inlet(
    info: pylsl.StreamInfo, limit_s: float, max_buflen: int = 1, *, as_numpy: bool = False
) -> pylsl.StreamInlet:
    """Return an inlet that gets what is sent from now on.

    Raises
    ------
    RuntimeError
        If liblsl cannot make it; ``TimeoutError`` or ``LostError`` of pylsl, if its outlet does
        not answer in time or is gone.
    """
    inlet = unopened_inlet(info, max_buflen, as_numpy=as_numpy)
    inlet.open_stream(limit_s)
    return inlet


def read_description(inlet: pylsl.StreamInlet, uid: str, limit_s: float) -> pylsl.StreamInfo:
    """Return what the outlet of an inlet says of its stream, with its description.

    An outlet that appears takes the port of one that has just ended, and answers whoever asks
    there, so that its header would be taken for that of the other stream.

    Raises
    ------
    RuntimeError
        ``TimeoutError`` or ``LostError`` of pylsl: it does not answer in time, or is gone.
    """
    info = inlet.info(limit_s)
    if info.uid() != uid:
        raise pylsl.util.LostError("another outlet has taken its port")
    return info


def undelivered(inlet: pylsl.StreamInlet) -> int:
    """Return how many samples liblsl drops of a lost stream, `LAST_ENTRY_S` after it was lost.

    The last entry of its queue is no sample: it wakes who waits. A thread of liblsl puts it there
    after it has called the stream lost, on a busy machine some time after, and nothing tells when.
    """
    return max(0, inlet.flush() - 1)
