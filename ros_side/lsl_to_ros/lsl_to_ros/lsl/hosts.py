"""Detects computers with an agent that have fallen silent.

An agent sends its counters once a second. If nothing at all comes from its computer for
longer, the network is cut or the agent hangs. A single stream cannot show this as early,
because a device may have nothing to send.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from time import monotonic

from biosensor_common.quantities import ContentType
from lsl_to_ros.lsl.inlets import Inlet

# Half a second longer than the period of the counters.
SILENT_AFTER_S = 1.5

Say = Callable[[str], None]


class Senders:
    """Watches the inlets of each computer that has an agent.

    Parameters
    ----------
    warn, inform
        Called with a sentence when a computer falls silent, and when it sends again.
    """

    def __init__(self, warn: Say, inform: Say) -> None:
        self._warn, self._inform = warn, inform
        self._silent: dict[str, float] = {}

    def look(self, inlets: Iterable[Inlet]) -> bool:
        """Update which computers are silent; return whether that has changed."""
        now, heard = monotonic(), _last_heard(inlets)
        silent = {host: at for host, at in heard.items() if now - at > SILENT_AFTER_S}
        fallen, returned = silent.keys() - self._silent.keys(), self._silent.keys() - silent.keys()
        for host in sorted(fallen):
            self._warn(f"{host}: {_sentence(now - silent[host])}")
        for host in sorted(returned & heard.keys()):
            self._inform(f"{host}: it is heard again, after {now - self._silent[host]:.1f} s")
        self._silent = silent
        return bool(fallen or returned)

    def trouble(self, host: str) -> str:
        """Return a sentence about a silent computer; empty if it is not silent."""
        heard_s = self._silent.get(host)
        return "" if heard_s is None else f"{host}: {_sentence(monotonic() - heard_s)}"


def _last_heard(inlets: Iterable[Inlet]) -> dict[str, float]:
    """Return when samples last came from each computer that has an agent."""
    heard: dict[str, float] = {}
    with_agent: set[str] = set()
    for inlet in inlets:
        if not inlet.heard_s:
            continue  # nothing is dropped: nothing came of it yet
        host = inlet.core.hostname
        heard[host] = max(heard.get(host, 0.0), inlet.heard_s)
        if inlet.core.content_type == ContentType.COUNTERS and not _is_foreign(inlet):
            with_agent.add(host)
    return {host: at for host, at in heard.items() if host in with_agent}


def _is_foreign(inlet: Inlet) -> bool:
    return inlet.header is None or inlet.header.foreign


def _sentence(seconds: float) -> str:
    return f"nothing has come for {seconds:.1f} s; is its network cut?"
