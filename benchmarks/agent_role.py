"""The agent, with a watch on the way of each packet: ``python -m benchmarks.agent_role FILE``.

It says when all devices stream, and measures from one line of its parent to the next, any
number of times, until there are no more.
"""

from __future__ import annotations

import asyncio
import json
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from numpy.typing import ArrayLike
from pylsl import local_clock

from biosensor_gateway.agent.agent import Agent
from biosensor_gateway.agent.control_server import ControlServer
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.single_instance import single_instance
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.settings.file import load_settings
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.logs import configure_logs

_POLL_S = 0.1


class Watch:
    """Times from `DeviceSink.observe`, which is told the arrival, to the end of the push.

    A driver observes a packet and emits its samples in one step of the event loop; what
    is emitted without a packet's arrival, a heart rate for instance, is not timed.
    """

    def __init__(self) -> None:
        self.delays_ms: list[float] = []
        self.samples = 0
        self._arrivals: dict[DeviceSink, float] = {}
        observe, emit_at = DeviceSink.observe, DeviceSink.emit_at
        watch = self

        def noted_observe(
            self: DeviceSink, device_s: float, arrival_s: float, kind: str = ""
        ) -> None:
            watch.arrived(self, arrival_s)
            observe(self, device_s, arrival_s, kind)

        def timed_emit_at(
            self: DeviceSink, data_name: str, samples: ArrayLike, lsl_times: Sequence[float]
        ) -> None:
            emit_at(self, data_name, samples, lsl_times)
            watch.pushed(self, len(lsl_times))

        DeviceSink.observe = noted_observe
        DeviceSink.emit_at = timed_emit_at

    def arrived(self, sink: DeviceSink, arrival_s: float) -> None:
        self._arrivals[sink] = arrival_s
        asyncio.get_running_loop().call_soon(self._arrivals.pop, sink, None)

    def pushed(self, sink: DeviceSink, count: int) -> None:
        self.samples += count
        if sink in self._arrivals:
            self.delays_ms.append(1000 * (local_clock() - self._arrivals[sink]))

    def restart(self) -> None:
        self.delays_ms.clear()
        self.samples = 0


async def _run(settings: Path) -> None:
    watch = Watch()
    folder = state_folder()
    agent = Agent(load_settings(settings, settings_models()), folder)
    running = asyncio.create_task(agent.run())
    loop = asyncio.get_running_loop()
    lines: asyncio.Queue[str] = asyncio.Queue()

    def read() -> None:
        for line in sys.stdin:
            loop.call_soon_threadsafe(lines.put_nowait, line)
        loop.call_soon_threadsafe(lines.put_nowait, "")

    threading.Thread(target=read, daemon=True).start()
    while any(each.supervisor.state is not State.STREAMING for each in agent.devices):  # noqa: ASYNC110 - seven devices, one poll
        await asyncio.sleep(_POLL_S)
    print("streaming", flush=True)
    with single_instance(folder):
        async with ControlServer(folder, agent.commands, agent.conversations):
            while await lines.get():
                watch.restart()
                print("measuring", flush=True)
                await lines.get()
                found = {"delays_ms": watch.delays_ms, "samples": watch.samples}
                print(json.dumps(found), flush=True)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)


if __name__ == "__main__":
    configure_logs(LogSettings(level="error"), None)
    asyncio.run(_run(Path(sys.argv[1])))
