"""The network as the source of the page."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path

from pylsl import local_clock

from biosensor_common.lsl.network import configure_lsl
from biosensor_common.lsl_config import LSL_BASE_PORT, LSL_DISCOVERY_PORT
from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.page.network.models import NetworkView
from biosensor_gateway.page.network.source import Reader
from biosensor_gateway.page.network_page.lsl_settings import lsl_settings
from biosensor_gateway.page.traces import Traces
from biosensor_gateway.settings.models import LslSettings

KEPT_S = 15.0
"""The page draws ten seconds."""
_TOLD_EVERY_S = 0.1
_STOPPED_AFTER_S = 5.0
_STOPPED = "the streams are not looked at any more; end this program and start it again"


class NetworkSource:
    """Shows the LSL streams that arrive at this computer; see `Source`.

    Configures LSL for this process, so there is one, made before any other call of LSL.

    Parameters
    ----------
    settings
        A settings file, of which the LSL section counts; it need not exist.

    Raises
    ------
    ConfigError
        The settings are wrong, or LSL's own are.
    """

    def __init__(self, settings: Path) -> None:
        lsl = lsl_settings(settings)
        own = configure_lsl(lsl.overrides)
        self.traces = Traces(KEPT_S)
        self.has_ended = False
        self.turns = 0
        self._search = _search(lsl, settings, own)
        self._reader: Reader | None = None

    @staticmethod
    def now() -> float:
        """Return the LSL time in seconds."""
        return local_clock()

    def status(self) -> NetworkView:
        """Describe all streams; none if what is known of them is old."""
        view = NetworkView() if self._reader is None else self._reader.view
        if view.made_s and local_clock() - view.made_s > _STOPPED_AFTER_S:
            return NetworkView(problems=[_STOPPED], search=self._search)
        return view.model_copy(update={"search": self._search})

    async def run(self) -> None:
        """Follow the streams until cancelled."""
        loop = asyncio.get_running_loop()

        def hand_over(samples: list[Samples]) -> None:
            # The loop may have ended a moment before the thread.
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(self._take, samples)

        self._reader = reader = Reader(hand_over)
        try:
            while True:
                reader.wanted = self.traces.wanted
                self.traces.history.keep_only(reader.wanted)
                await asyncio.sleep(_TOLD_EVERY_S)
        finally:
            reader.stop()

    def _take(self, samples: list[Samples]) -> None:
        for each in samples:
            self.traces.take(each)


def _search(lsl: LslSettings, settings: Path, own: Path | None) -> list[str]:
    session = f"{lsl.session_id!r}" if lsl.session_id else "of LSL's own settings"
    peers = f", and asks {', '.join(lsl.known_peers)} directly" if lsl.known_peers else ""
    own_file = own or "no file, so the usual ones"
    return [
        f"This page looks in the LSL session {session}{peers}.",
        f"LSL's own settings: {own_file}. Ours: {settings}, section [lsl].",
        "The senders must run, and have the same session.",
        "Run biosensor-gateway doctor here and on the sender's computer: it says what is wrong.",
        f"A firewall must pass UDP {LSL_DISCOVERY_PORT} and LSL's ports from {LSL_BASE_PORT} on.",
        "Where multicast does not get through, name the sender: known_peers in section [lsl].",
    ]
