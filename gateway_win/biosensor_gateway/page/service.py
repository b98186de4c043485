"""The first half of what is loaded while the server runs already: what the page shows."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import math
from collections.abc import Callable
from pathlib import Path

from starlette.routing import Router

from biosensor_gateway.agent.control import CONTROL_FILE, HOST, json_object, line
from biosensor_gateway.agent.feed_frames import (
    HEAD,
    FrameKind,
    Samples,
    read_count,
)
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.agent.status import AgentStatus
from biosensor_gateway.page.live import live
from biosensor_gateway.page.session import Session
from biosensor_gateway.page.shutdown import Shutdown
from biosensor_gateway.system import state_file

_FIRST_S = 1.5
RETRY_S = 0.25
_READING = (
    "pylsl",
    "biosensor_gateway.agent.sample_frames",
    "biosensor_gateway.page.bins",
)
SILENT_AFTER_S = 4.0
"""The agent tells its status every second; one that does not for so long is stuck."""


class Service:
    """Shows the agent, its devices and what they measure.

    Parameters
    ----------
    folder
        The state folder of the agent.
    settings
        The settings file.
    end_after_s
        See `Shutdown`.

    Attributes
    ----------
    live
        The application of the WebSocket.
    """

    def __init__(self, folder: Path, settings: Path, end_after_s: float = math.inf) -> None:
        self.session = session = Session(folder, settings)
        self.shutdown = Shutdown(session, end_after_s)
        self.live = Router([live(session, session.status)])

    async def shown(self) -> None:
        """Wait until a browser was told what there is; not long, for there may be none."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_FIRST_S):
                await self.session.told.wait()

    async def run(self) -> None:
        """Follow the agent until cancelled."""
        session = self.session
        link = AgentLink(
            session.folder, session.take_status, session.traces.take, session.take_dropped
        )
        await link.run()


class AgentLink:
    """Follows the agent of a state folder.

    Parameters
    ----------
    folder
        The state folder.
    on_status
        Is given the agent's status, once a second; None when there is no agent any more.
    on_samples
        Is given what a stream has sent.
    on_dropped
        Is told how many samples are missing here, because this program was too slow.
    """

    def __init__(
        self,
        folder: Path,
        on_status: Callable[[AgentStatus | None], None],
        on_samples: Callable[[Samples], None],
        on_dropped: Callable[[int], None],
    ) -> None:
        self._folder = folder
        self._on_status = on_status
        self._on_samples = on_samples
        self._on_dropped = on_dropped
        self._can_read = False

    async def run(self) -> None:
        """Receive until cancelled."""
        while True:
            # The port of a killed agent may be another program's by now.
            if is_held(self._folder):
                with contextlib.suppress(OSError, ValueError, EOFError, TimeoutError):
                    await self._follow()
                self._on_status(None)
            await asyncio.sleep(RETRY_S)

    async def _follow(self) -> None:
        place = json_object(state_file.read(self._folder / CONTROL_FILE).encode()) or {}
        reader, writer = await asyncio.open_connection(HOST, int(place.get("port", 0)))
        try:
            writer.write(line({"token": place.get("token"), "command": "feed"}))
            async with asyncio.timeout(SILENT_AFTER_S):
                answer = json_object(await reader.readline())
            if answer is None or answer.get("ok") is not True:
                _warn("the agent shows nothing", answer=answer)
                return
            while True:
                async with asyncio.timeout(SILENT_AFTER_S):
                    length, kind = HEAD.unpack(await reader.readexactly(HEAD.size))
                    content = await reader.readexactly(length)
                self._take(kind, content)
                if kind == FrameKind.STATUS and not self._can_read:
                    self._can_read = await asyncio.to_thread(_load_reading)
        finally:
            writer.transport.abort()

    def _take(self, kind: int, content: bytes) -> None:
        if kind == FrameKind.STATUS:
            self._on_status(AgentStatus.model_validate_json(content))
        elif kind == FrameKind.SAMPLES:
            from biosensor_gateway.agent.sample_frames import read_samples

            self._on_samples(read_samples(content))
        elif kind == FrameKind.DROPPED:
            self._on_dropped(read_count(content))


def _load_reading() -> bool:
    """Load what samples need, beside the loop: devices are shown meanwhile."""
    for name in _READING:
        importlib.import_module(name)
    return True


def _warn(event: str, **facts: object) -> None:
    # It takes a fifth of a second, and the page shows devices before.
    import structlog

    structlog.get_logger("biosensor_gateway.page").warning(event, **facts)
