"""The pipes to the process that reads a board."""

from __future__ import annotations

import contextlib
import os
import subprocess

from pylsl import local_clock

from biosensor_gateway.devices.brainflow.driver.process import order, start
from biosensor_gateway.devices.brainflow.driver.settings import BrainFlowSettings
from biosensor_gateway.transports.link import Received
from biosensor_gateway.transports.threads import in_daemon_thread
from biosensor_gateway.transports.traffic import Traffic

_READ_BYTES = 65536
_END_LIMIT_S = 3.0


class ProcessLink:
    """Starts the process, reads from it in a thread, and ends it."""

    def __init__(self, settings: BrainFlowSettings) -> None:
        self._settings = settings
        self._process: subprocess.Popen[bytes] | None = None
        self._traffic = Traffic("BrainFlow", "the process that reads the board has ended")

    async def open(self, presets: tuple[int, ...]) -> None:
        """Start it and tell it what to read.

        Raises
        ------
        TransportError
            ``UNAVAILABLE``: there is no such Python.
        """
        process = await in_daemon_thread(lambda: start(self._settings, "stream"))
        self._process = process
        self._traffic.start(lambda: self._read_forever(process), lambda: self._write(process))
        self._traffic.write(order(self._settings, presets))

    async def read(self) -> Received:
        """Wait for the next bytes; raise ``LOST`` when the process has ended."""
        return await self._traffic.read()

    async def close(self) -> None:
        """Let the process release the board, and end it if it does not."""
        self._traffic.closing = True
        self._traffic.end_writing()
        if self._process is not None:
            await in_daemon_thread(self._end)

    def _end(self) -> None:
        process = self._process
        assert process is not None
        try:
            process.wait(_END_LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._traffic.join_reader(_END_LIMIT_S)

    def _read_forever(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        with process.stdout as pipe:
            while data := os.read(pipe.fileno(), _READ_BYTES):
                self._traffic.deliver(data, local_clock())
        self._traffic.lost()

    def _write(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdin is not None
        with contextlib.suppress(OSError), process.stdin as pipe:
            for data in self._traffic.outgoing():
                pipe.write(data)
                pipe.flush()
