"""Driver for the Zephyr BioHarness: enables its packets, and keeps it awake."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from pydantic import Field

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.driver import Connected, DriverEntry, by_port_name, own_settings
from biosensor_gateway.devices.zephyr.driver.emitter import ZephyrEmitter
from biosensor_gateway.devices.zephyr.driver.messages import (
    Message,
    Reply,
    RrIntervals,
    Summary,
    Unknown,
)
from biosensor_gateway.devices.zephyr.driver.protocol import (
    HXM,
    LIFESIGN,
    Request,
    ZephyrProtocol,
    enable,
)
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.byte_links import byte_link
from biosensor_gateway.transports.dialogue import Dialogue, Heard

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

# The same order as in a recorded session.
PACKETS = (
    Request.ECG,
    Request.BREATHING,
    Request.RR,
    Request.ACCELERATION,
    Request.SUMMARY,
)
STREAMS = {
    Request.ECG: ("ecg",),
    Request.BREATHING: ("breathing",),
    Request.RR: ("ibi",),
    Request.ACCELERATION: ("acc",),
    Request.SUMMARY: ("quality", "hr", "br", "posture", "activity"),
    Request.GENERAL: ("quality",),
}
"""Streams that are monitored for each packet, which may contain others, too."""
DUE = {"ibi": 5.0, "quality": 10.0}
"""Packets of these streams come once a second, with or without a value; old firmware must first be
switched to general data."""
REPLY_TIMEOUT_S = 2.0
ATTEMPTS = 3
LIFESIGN_PERIOD_S = 2.0
TORN_FRAME_S = 1.0
"""Longest gap within a frame; recorded Bluetooth reads are up to 0.51 s apart."""
SUMMARY_PATIENCE_S = 5.0

ONLY_IN_SUMMARIES = ("hrv", "rssi")
"""Streams that general data lack."""
_DENIED = "it refuses to send their packets; update its firmware"


class ZephyrSettings(DeviceSettings):
    """Settings of one BioHarness."""

    port: str = Field(
        min_length=1,
        description="Serial port of the paired BioHarness, COM7 or /dev/rfcomm0 for instance, "
        "or its Bluetooth address, 00:07:80:5A:3E:7E for instance, or socket://HOST:NUMBER.",
        examples=["/dev/rfcomm0"],
    )


class ZephyrDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    # The device sends a lifesign every 3 s, whatever is enabled.
    silence_limit_s = 10.0

    def __init__(self, settings: ZephyrSettings, sink: DeviceSink, emitter: ZephyrEmitter) -> None:
        self._port = settings.port
        self._link = byte_link(settings.port)
        self._sink = sink
        self._emitter = emitter
        self._protocol = ZephyrProtocol()
        self._dialogue = Dialogue(self._receive, self._link.write)
        self._enabled: list[Request] = []
        self._has_heard = self._is_hxm = False
        self._summary_seen = False
        self._arrival_s = 0.0

    async def connect(self) -> Connected:
        """Open the port and enable every packet; see the protocol class."""
        await self._link.open()
        self._dialogue.begin()
        self._emitter.reconnected()
        refused = [packet for packet in PACKETS if not await self._enable(packet)]
        has_no_summary = Request.SUMMARY in refused
        if Request.SUMMARY in refused and await self._enable(Request.GENERAL):
            refused.remove(Request.SUMMARY)
        if not self._enabled:
            message = f"{self._port}: the device refuses every packet; is it a BioHarness 3?"
            raise ProtocolError(ProtocolReason.REFUSED, message)
        denied = {name: _DENIED for packet in refused for name in STREAMS[packet]}
        if has_no_summary:
            denied |= dict.fromkeys(ONLY_IN_SUMMARIES, _DENIED)
        due = {name: limit_s for name, limit_s in DUE.items() if name not in denied}
        return Connected(denied=denied, due=due)

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Enable the packets of silent streams again, without waiting for replies."""
        for packet in [each for each in self._enabled if not streams.isdisjoint(STREAMS[each])]:
            self._link.write(enable(packet, on=True))

    async def stream(self) -> None:
        """Emit data received since connecting."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._stay_awake())
            tasks.create_task(self._fall_back_to_general())
            tasks.create_task(self._dialogue.stream(self._take))

    async def close(self) -> None:
        """Disable the enabled packets without waiting for replies."""
        for packet in self._enabled:
            self._link.write(enable(packet, on=False))
        await self._dialogue.close()
        await self._link.close()

    async def _enable(self, packet: Request) -> bool:
        """Enable a packet; return whether the device accepted.

        Raises
        ------
        ProtocolError
            ``NO_REPLY`` or ``GARBAGE``.
        """
        # Added before the answer, which may arrive after the timeout.
        self._enabled.append(packet)

        def is_reply(heard: Heard[Message]) -> Reply | None:
            message = heard.message
            return message if isinstance(message, Reply) and message.request_id == packet else None

        for _ in range(ATTEMPTS):
            reply = await self._dialogue.ask(enable(packet, on=True), is_reply, REPLY_TIMEOUT_S)
            if reply is not None:
                if not reply.accepted:
                    self._enabled.remove(packet)
                return reply.accepted
        if self._is_hxm:
            message = (
                f"{self._port}: the device that answers is a Zephyr HxM, which is not supported; "
                "choose the port of a BioHarness 3 in the settings"
            )
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        if self._protocol.dropped_bytes and not self._has_heard:
            message = (
                f"{self._port}: the device that answers is not a BioHarness; choose its port in "
                "the settings"
            )
            raise ProtocolError(ProtocolReason.GARBAGE, message)
        message = f"{self._port}: the device does not answer; switch it off and on"
        raise ProtocolError(ProtocolReason.NO_REPLY, message)

    async def _receive(self) -> list[Heard[Message]]:
        """Wait for bytes, at most until an incomplete frame must be discarded."""
        before = self._protocol.dropped_bytes
        try:
            async with asyncio.timeout(TORN_FRAME_S if self._protocol.buffered else None):
                data, self._arrival_s = await self._link.read()
            messages = self._protocol.feed(data)
        except TimeoutError:
            messages = self._protocol.give_up()
        self._sink.dropped_bytes += self._protocol.dropped_bytes - before
        self._has_heard = self._has_heard or bool(messages)
        self._is_hxm = self._is_hxm or any(each == Unknown(HXM) for each in messages)
        return [Heard(message, self._arrival_s) for message in messages]

    def _take(self, found: Sequence[Heard[Message]]) -> None:
        for message, arrival_s in found:
            self._sink.heard(*(("ibi",) if isinstance(message, RrIntervals) else ()))
            if isinstance(message, Summary) and not self._summary_seen:
                self._summary_seen = True
                self._sink.remark("summary")
            self._emitter.take(message, arrival_s)

    async def _stay_awake(self) -> None:
        while True:
            self._link.write(LIFESIGN)
            await asyncio.sleep(LIFESIGN_PERIOD_S)

    async def _fall_back_to_general(self) -> None:
        """Enable general data, because old firmware accepts the summary request but sends none."""
        await asyncio.sleep(SUMMARY_PATIENCE_S)
        if not self._summary_seen and Request.GENERAL not in self._enabled:
            self._link.write(enable(Request.GENERAL, on=True))
            self._enabled.append(Request.GENERAL)
            missing = " and ".join(ONLY_IN_SUMMARIES)
            self._sink.remark(
                "summary", f"{missing} are missing: it sends no summaries; update its firmware"
            )


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], ZephyrDriver]:
    """Share one emitter between all connections, to detect gaps across them."""
    own = own_settings(ZephyrSettings, settings)
    emitter = ZephyrEmitter(sink)
    return lambda: ZephyrDriver(own, sink, emitter)


recognise = by_port_name("zephyr", r"BH ?([A-Z]{3}[0-9]{6})")
DRIVER = DriverEntry(ZephyrSettings, _make, recognise=recognise)
