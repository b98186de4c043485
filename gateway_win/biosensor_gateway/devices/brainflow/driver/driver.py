"""Has a process with BrainFlow read one board, and starts another one when it hangs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from biosensor_common.errors import GatewayError, TransportError, TransportReason
from biosensor_common.spec import SensorSpec
from biosensor_gateway.devices.brainflow.declaration import (
    BoardStream,
    Description,
    board_spec,
    board_streams,
)
from biosensor_gateway.devices.brainflow.driver.emitter import (
    COUNTS_UP_TO,
    PresetEmitter,
    own_clock,
)
from biosensor_gateway.devices.brainflow.driver.frames import Frames, Rows, Told
from biosensor_gateway.devices.brainflow.driver.process import ProcessLink, described, refusal
from biosensor_gateway.devices.brainflow.driver.settings import BrainFlowSettings
from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.early import Early
from biosensor_gateway.transports.threads import in_daemon_thread

START_LIMIT_S = 60.0
"""Bluetooth boards are searched for by BrainFlow, some for half a minute."""
HANGS_S = 5.0
"""The process sends a sign of life every second, whatever its board does."""
_MOST_EARLY = 4096
"""More than fit into the read that says that the board has started."""


class BrainFlowDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    silence_limit_s = 10.0

    def __init__(self, settings: BrainFlowSettings, sink: Sink, *, is_declared: bool) -> None:
        self._settings, self._sink = settings, sink
        self._is_declared = is_declared
        self._link = ProcessLink(settings)
        self._frames = Frames()
        self._early = Early[tuple[Rows, float]](_MOST_EARLY)
        self._described: Mapping[int, Description] = {}

    async def connect(self) -> Connected:
        """Start the process, and wait until it has the board."""
        self._described = await in_daemon_thread(lambda: described(self._settings))
        if not self._is_declared:
            message = f"BrainFlow says now what {self._settings.board} has; start the agent anew"
            raise TransportError(TransportReason.UNAVAILABLE, message)
        await self._link.open(tuple(sorted(self._described)))
        try:
            async with asyncio.timeout(START_LIMIT_S):
                while not await self._has_started():
                    pass
        except TimeoutError as error:
            message = (
                f"BrainFlow has been looking for {self._settings.board} for {START_LIMIT_S:g} s"
            )
            raise TransportError(TransportReason.ABSENT, f"{message}; is it on?") from error
        return Connected()

    async def stream(self) -> None:
        """Emit all that comes."""
        self._sink.restart_clock()
        emitters = self._emitters()
        for rows, arrival_s in self._early.take():
            emitters[rows.preset].take(rows, arrival_s)
        while True:
            for frame, arrival_s in await self._read(HANGS_S):
                if isinstance(frame, Rows):
                    emitters[frame.preset].take(frame, arrival_s)
                else:
                    self._raise_refusal(frame)

    async def close(self) -> None:
        """End the process."""
        await self._link.close()

    async def _has_started(self) -> bool:
        has_started = False
        for frame, arrival_s in await self._read(START_LIMIT_S):
            if isinstance(frame, Rows):
                self._early.keep((frame, arrival_s))
            else:
                self._raise_refusal(frame)
                has_started = has_started or "started" in frame.what
        return has_started

    async def _read(self, limit_s: float) -> list[tuple[Rows | Told, float]]:
        try:
            async with asyncio.timeout(limit_s):
                data, arrival_s = await self._link.read()
        except TimeoutError as error:
            message = "the process that reads the board hangs; it is started anew"
            raise TransportError(TransportReason.SILENT, message) from error
        return [(frame, arrival_s) for frame in self._frames.feed(data)]

    def _raise_refusal(self, told: Told) -> None:
        if "error" in told.what:
            raise refusal(self._settings, told.what)

    def _emitters(self) -> dict[int, PresetEmitter]:
        streams = _streams(self._settings, self._described)
        return {
            preset: PresetEmitter(
                [stream for stream in streams if stream.preset == preset],
                description,
                _rate_hz(self._settings, preset, description),
                COUNTS_UP_TO.get((self._settings.board, preset), 0),
                self._sink,
                self._sink if preset == 0 else own_clock(self._sink),
            )
            for preset, description in self._described.items()
        }


def _rate_hz(settings: BrainFlowSettings, preset: int, description: Description) -> float:
    if settings.rate_hz and preset == 0:
        return settings.rate_hz
    return float(description["sampling_rate"])


def _streams(
    settings: BrainFlowSettings, found: Mapping[int, Description]
) -> tuple[BoardStream, ...]:
    return board_streams(found, settings.electrodes, settings.rate_hz)


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], BrainFlowDriver]:
    own = own_settings(BrainFlowSettings, settings)
    is_declared = bool(_declare(own).streams)
    return lambda: BrainFlowDriver(own, sink, is_declared=is_declared)


def _declare(settings: DeviceSettings) -> SensorSpec:
    """Say what a board has; nothing where BrainFlow cannot be asked, which connecting tells."""
    own = own_settings(BrainFlowSettings, settings)
    try:
        streams = _streams(own, described(own))
    except GatewayError:
        streams = ()
    return board_spec(own.sensor_name, own.board, streams)


DRIVER = DriverEntry(BrainFlowSettings, _make, declare=_declare)
