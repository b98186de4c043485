"""One connection to a Shimmer of any kind: starts it and passes on its data."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import structlog

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.driver import Connected
from biosensor_gateway.devices.shimmer.driver import messages
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation, Kind, identify
from biosensor_gateway.devices.shimmer.driver.messages import (
    BatteryReading,
    Hardware,
    Packet,
    Stamped,
    Status,
    StatusFlag,
)
from biosensor_gateway.devices.shimmer.driver.packets import PacketEmitter
from biosensor_gateway.transports.byte_links import byte_link

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

BATTERY_PERIOD_S = 60.0
"""The firmware itself measures the battery once a minute."""
PATIENCE_S = 2.0

_log = structlog.get_logger("biosensor_gateway.shimmer")


class Prepared(NamedTuple):
    """A device that is ready to start."""

    # layout, divisor: layout of its data packets, and ticks between two packets.
    layout: Layout
    divisor: int
    begin: Callable[[], None]  # Prepares the emitter for packets of a new start.
    connected: Connected = Connected()  # Information about its streams.
    # Why values may be wrong, as clauses, by what they are about.
    remarks: Mapping[str, str] = MappingProxyType({})


class ShimmerDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`.

    Parameters
    ----------
    port
        The port to open, which also names the device in messages.
    prepare
        Sets an identified device up.
    """

    # Silent streams are detected much earlier.
    silence_limit_s = 10.0

    def __init__(
        self,
        port: str,
        sink: DeviceSink,
        emitter: PacketEmitter,
        prepare: Callable[[Conversation, Kind], Awaitable[Prepared]],
    ) -> None:
        self._port = port
        self._talk = Conversation(port, byte_link(port))
        self._sink = sink
        self._emitter = emitter
        self._prepare = prepare
        self._dropped_bytes = 0
        self._prepared: Prepared | None = None
        self._is_docked: bool | None = None
        self._kind: Kind | None = None

    async def connect(self) -> Connected:
        """Open the link, set the device up and start it; see the protocol class."""
        streamed_until_s = await self._talk.open()
        if streamed_until_s is not None:
            self._emitter.kept_measuring_until(streamed_until_s)
        self._kind = await identify(self._talk, self._port)
        self._prepared = await self._prepare(self._talk, self._kind)
        await self._start(self._prepared)
        info = DeviceInfo(firmware_version=str(self._kind.firmware))
        return replace(self._prepared.connected, info=info, patience_s=PATIENCE_S)

    async def stream(self) -> None:
        """Emit data received since connecting."""
        if self._prepared is not None:
            for about, text in self._prepared.remarks.items():
                self._sink.remark(about, text)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._talk.stream(self._hear))
            tasks.create_task(self._ask_for_the_battery())

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Restart a device that answers but sends no data; see the protocol class."""
        del streams
        assert self._prepared is not None
        is_there = await self._is_there()
        if not self._sink.is_waiting:
            return  # data came before the answer
        # The device may have continued to measure.
        self._emitter.kept_measuring_until(self._sink.clock())
        if not is_there:
            message = f"{self._port}: the device has gone silent; it is restarted"
            raise TransportError(TransportReason.SILENT, message)
        await self._start(self._prepared)

    async def close(self) -> None:
        """Stop the device without waiting for its answer."""
        self._count_dropped()
        await self._talk.close()

    async def _start(self, prepared: Prepared) -> None:
        prepared.begin()
        await self._talk.start_streaming(prepared.layout, prepared.divisor)

    def _hear(self, found: Sequence[Stamped]) -> None:
        self._count_dropped()
        packets: list[tuple[Packet, float]] = []
        for message, arrival_s in found:
            match message:
                case Packet():
                    packets.append((message, arrival_s))
                case BatteryReading():
                    self._emitter.battery(message, arrival_s)
                case Status():
                    self._note(message)
                case _:
                    pass
        if packets:
            self._sink.heard()
            self._emitter.take(packets)

    def _count_dropped(self) -> None:
        dropped = self._talk.dropped_bytes
        self._sink.dropped_bytes += dropped - self._dropped_bytes
        self._dropped_bytes = dropped

    def _note(self, status: Status) -> None:
        is_docked = StatusFlag.DOCKED in status.flags
        if is_docked != self._is_docked:
            self._is_docked = is_docked
            _log.info("docked" if is_docked else "not docked", port=self._port)

    async def _is_there(self) -> bool:
        assert self._kind is not None
        if self._kind.has_status:
            return await self._talk.poll(messages.GET_STATUS, Status) is not None
        return await self._talk.poll(messages.GET_HARDWARE, Hardware) is not None

    async def _ask_for_the_battery(self) -> None:
        assert self._kind is not None
        while self._kind.has_status:
            await asyncio.sleep(BATTERY_PERIOD_S)
            await self._talk.poll(messages.GET_BATTERY, BatteryReading)
