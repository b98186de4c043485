"""Makes inlets that wait for nothing without a limit and go on with no other outlet.

The first pull of an inlet that was never opened waits for its outlet as long as liblsl recovers
lost streams, for ever if the outlet is gone. And liblsl recovers by name, type and source_id
alone: it goes on with an outlet of another session or with another header. So liblsl never
recovers here. Whoever lost a stream looks for it again, by a resolver of the own session, and
reads its header again.
"""

from __future__ import annotations

import pylsl


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
