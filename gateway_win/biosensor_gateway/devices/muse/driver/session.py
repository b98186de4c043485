"""One connection to a headband: what is asked of it, and where its packets go."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

from biosensor_common.errors import GatewayError, ProtocolError, ProtocolReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.muse.driver import commands
from biosensor_gateway.devices.muse.driver.commands import text_of
from biosensor_gateway.devices.muse.driver.conversation import Conversation
from biosensor_gateway.devices.muse.driver.emitter import MuseEmitter, Started
from biosensor_gateway.devices.muse.driver.gatt import (
    ACC,
    AUX,
    CONTROL,
    EEG,
    FRAMES,
    GYRO,
    PPG,
    TELEMETRY,
)
from biosensor_gateway.devices.muse.driver.models import (
    ATHENA,
    CLASSIC,
    athena_preset,
    classic_preset,
    model_of,
)
from biosensor_gateway.devices.muse.driver.settings import MuseSettings
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.nearby import Advertisement

KEEP_ALIVE_S = 10.0
"""Headbands that hear nothing end the stream after some minutes (muse-lsl, issue 184)."""
GOODBYE_LIMIT_S = 0.45
_ALWAYS = frozenset({"eeg", "acc", "gyro"})
_OPTIONAL = frozenset({"aux", "ppg", "optics"})


class Opened(NamedTuple):
    """What is known of a headband that streams.

    Attributes
    ----------
    info
    silent
        Data names of streams that the settings switch off.
    refused
        Data names of streams that it does not have.
    """

    info: DeviceInfo
    silent: frozenset[str]
    refused: frozenset[str]


class MuseSession:
    """Everything that lasts as long as one link.

    Parameters
    ----------
    link, emitter, sink, settings
    """

    def __init__(
        self, link: BleLink, emitter: MuseEmitter, sink: Sink, settings: MuseSettings
    ) -> None:
        self._link = link
        self._emitter = emitter
        self._sink = sink
        self._settings = settings
        self._conversation = Conversation(link)
        self._seen: tuple[Advertisement, float] | None = None
        self._preset = ""
        self._started = Started(_ALWAYS, None)

    async def open(self) -> Opened:
        """Connect, start everything, and return what the headband says of itself.

        Raises
        ------
        TransportError, ProtocolError
            The headband cannot be used now.
        """
        self._seen = await self._link.open(), self._link.clock()
        if not self._link.has(CONTROL) or not (self._link.has(EEG[0]) or self._is_athena):
            message = (
                f"{self._link.what} does not offer the services of a Muse of 2016 or later; if it "
                "is one, hold its button for 30 s, which resets it"
            )
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        await self._conversation.begin()
        offer = commands.VERSION_OF_FRAMES if self._is_athena else commands.VERSION
        version = await self._conversation.ask(offer, "fw")
        status = await self._conversation.ask(commands.STATUS, "sn")
        serial = text_of(status, "sn")
        self._preset, wanted = self._chosen(serial)
        self._started = Started(_ALWAYS | wanted, commands.battery_percent(status))
        for uuid in self._sources(wanted):
            await self._link.subscribe(uuid)
        await self._start()
        refused = {"ppg"} if self._is_athena else {"optics"}
        if not (self._is_athena or self._link.has(PPG[0])):
            refused.add("ppg")
        silent = _OPTIONAL - wanted - refused
        model = model_of(serial) or ("Muse S Athena" if self._is_athena else "")
        info = DeviceInfo("", model, serial, text_of(version, "fw"))
        return Opened(info, frozenset(silent), frozenset(refused))

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        """
        if self._seen is not None:
            self._emitter.signal_strength(self._seen[0].rssi_dbm, self._seen[1])
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._keep_alive())
            tasks.create_task(self._conversation.stream(self._take))

    async def start_again(self) -> None:
        """Tell it once more what to send.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``NO_REPLY`` or ``REFUSED``.
        """
        await self._start()

    async def close(self) -> None:
        """Stop everything, for a moment, and disconnect; never raises."""
        with suppress(GatewayError, TimeoutError):
            async with asyncio.timeout(GOODBYE_LIMIT_S):
                await self._conversation.tell(commands.HALT)
        await self._conversation.close()
        await self._link.close()

    @property
    def _is_athena(self) -> bool:
        return self._link.has(FRAMES[0])

    async def _start(self) -> None:
        await self._conversation.ask(commands.HALT)
        await self._conversation.ask(self._preset)
        # Before the command: packets may come before its answer.
        self._emitter.started(self._started)
        await self._conversation.ask(commands.START_FRAMES if self._is_athena else commands.START)

    def _chosen(self, serial: str) -> tuple[str, frozenset[str]]:
        """Return the preset, and which optional streams are to come with it."""
        own, has_ppg = self._settings, self._link.has(PPG[0])
        known = ATHENA if self._is_athena else CLASSIC
        preset = own.preset or (
            athena_preset(aux=own.aux, light=own.optics)
            if self._is_athena
            else classic_preset(serial, aux=own.aux, ppg=own.ppg and has_ppg)
        )
        if preset not in known:
            message = f"{self._link.what} has no preset {preset}; leave it empty in the settings"
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        sent = known[preset]
        light = "optics" if self._is_athena else "ppg"
        wants_light = bool(own.optics) if self._is_athena else own.ppg and has_ppg
        wanted = {
            *(["aux"] if own.aux and sent.has_aux else []),
            *([light] if wants_light and sent.light else []),
        }
        return preset, frozenset(wanted)

    def _sources(self, wanted: frozenset[str]) -> Sequence[str]:
        """Return the characteristics that send what is wanted."""
        if self._is_athena:
            return [uuid for uuid in FRAMES if "notify" in self._link.properties(uuid)]
        return [
            *EEG,
            *([AUX] if "aux" in wanted else []),
            *(PPG if "ppg" in wanted else []),
            ACC,
            GYRO,
            TELEMETRY,
        ]

    async def _keep_alive(self) -> None:
        while True:
            await asyncio.sleep(KEEP_ALIVE_S)
            await self._conversation.tell(commands.KEEP_ALIVE)

    def _take(self, found: Sequence[Notification]) -> None:
        for notification in found:
            if notification.uuid == CONTROL:
                self._sink.heard()
            else:
                self._emitter.take(notification)
