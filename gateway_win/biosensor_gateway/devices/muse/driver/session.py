"""One connection to a headband: what is asked of it, and where its packets go."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from biosensor_common.errors import GatewayError, ProtocolError, ProtocolReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.muse.driver import commands
from biosensor_gateway.devices.muse.driver.commands import Answer, Answers, text_of
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
from biosensor_gateway.devices.muse.driver.settings import MuseSettings
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.ble_errors import AttError
from biosensor_gateway.transports.dialogue import Dialogue
from biosensor_gateway.transports.nearby import Advertisement

KEEP_ALIVE_S = 10.0
"""Headbands that hear nothing end the stream after some minutes (muse-lsl, issue 184)."""
GOODBYE_LIMIT_S = 0.45
_ALWAYS = frozenset({"eeg", "acc", "gyro"})
_OPTIONAL = frozenset({"aux", "ppg", "optics"})

# Sources: BrainFlow's list of supported boards for what presets send; recordings of an Athena in
# OpenMuse (`tests/test_data`), in which those of two digits send no light; the package openble-muse
# for serial numbers.
_MODELS = {
    "2": "Muse 2016",
    "4": "Muse 2",
    "5": "Muse S",
    "6": "Muse S",
    "7": "Muse S Athena",
}
MUSE_S = frozenset({"5", "6"})


class _Preset(NamedTuple):
    """What a headband sends besides four channels of EEG, acceleration and rotation.

    Attributes
    ----------
    has_aux
        The inputs for electrodes of one's own.
    light
        Channels of light.
    """

    has_aux: bool
    light: int


CLASSIC_PRESETS = {
    "p20": _Preset(True, 0),
    "p21": _Preset(False, 0),
    "p50": _Preset(True, 3),
    "p51": _Preset(False, 3),
    "p60": _Preset(True, 3),
    "p61": _Preset(False, 3),
}
"""Of headbands before the Athena; the last two of a Muse S."""
ATHENA_PRESETS = {
    "p21": _Preset(False, 0),
    "p1034": _Preset(False, 8),
    "p1035": _Preset(False, 4),
    "p1041": _Preset(True, 16),
    "p1042": _Preset(True, 16),
    "p1043": _Preset(True, 8),
    "p1044": _Preset(True, 8),
    "p1045": _Preset(True, 4),
    "p1046": _Preset(True, 4),
}


def model_of(serial: str) -> str:
    """Return the model by its serial number, empty if that tells nothing."""
    return _MODELS.get(serial[:1], "")


def classic_preset(serial: str, *, aux: bool, ppg: bool) -> str:
    """Return the preset of a Muse 2 or Muse S."""
    decade = 20 if not ppg else 60 if serial[:1] in MUSE_S else 50
    return f"p{decade if aux else decade + 1}"


def athena_preset(*, aux: bool, light: int) -> str:
    """Return the preset of an Athena with the fewest channels that has what is wanted."""
    fitting = [
        (preset.light, preset.has_aux, name)
        for name, preset in ATHENA_PRESETS.items()
        if preset.light >= light and preset.has_aux >= aux
    ]
    return min(fitting)[2]


ANSWER_LIMIT_S = 5.0


class _Conversation:
    """What is said over one connection.

    Parameters
    ----------
    link
    """

    def __init__(self, link: BleLink) -> None:
        self._link = link
        # One for all questions: a packet may end an answer and begin the next one.
        self._answers = Answers()
        self._fresh: list[Answer] = []
        self._dialogue: Dialogue[Notification, str] = Dialogue(self._receive, self.tell)

    async def begin(self) -> None:
        """Listen to answers.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``UNSUPPORTED``: it is no Muse of these generations.
        """
        # Before the first command, whose answer would be lost otherwise.
        await self._link.subscribe(CONTROL)
        self._dialogue.begin()

    async def ask(self, command: str, key: str = "rc") -> Answer:
        """Send a command and return its answer.

        Parameters
        ----------
        command
        key
            A field that the answer has, and no other one: an earlier one may come late.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        ProtocolError
            ``NO_REPLY`` or ``REFUSED``.
        """

        def match(notification: Notification) -> Answer | None:
            if notification.uuid != CONTROL:
                return None
            fits = (each for each in self._fresh if key in each or commands.return_code(each))
            return next(fits, None)

        answer = await self._dialogue.ask(command, match, ANSWER_LIMIT_S)
        if answer is None:
            message = f"{self._link.what}: no answer to the command {command}; switch it off and on"
            raise ProtocolError(ProtocolReason.NO_REPLY, message)
        code = commands.return_code(answer)
        if code:
            message = (
                f"{self._link.what} refuses the command {command} ({code}); switch it off and on, "
                "and leave preset empty in its settings"
            )
            raise ProtocolError(ProtocolReason.REFUSED, message)
        return answer

    async def tell(self, command: str) -> None:
        """Send a command without waiting for its answer; raises as `ask` does."""
        await self._link.write(CONTROL, commands.encode(command), response=False)

    async def stream(self, listener: Callable[[Sequence[Notification]], None]) -> None:
        """Pass on all notifications since `begin`.

        Raises
        ------
        TransportError
            ``LOST``, once everything that had arrived was passed on.
        """
        await self._dialogue.stream(listener)

    async def close(self) -> None:
        """Listen no more."""
        await self._dialogue.close()

    async def _receive(self) -> Sequence[Notification]:
        notification = await self._link.next()
        if notification.uuid == CONTROL:
            first = self._answers.feed(notification.data)
            self._fresh = [] if first is None else [first, *self._answers.complete]
        return (notification,)


class Opened(NamedTuple):
    """What is known of a headband that streams.

    Attributes
    ----------
    info
    silent
        Data names of streams that the settings switch off, or that it does not have.
    refused
        Data names of streams that it does not have.
    denied
        By data name, why it does not give streams.
    """

    info: DeviceInfo
    silent: frozenset[str]
    refused: frozenset[str]
    denied: Mapping[str, str]


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
        self._conversation = _Conversation(link)
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
        denied = await self._subscribe(self._sources(wanted))
        await self._start()
        refused = {"ppg"} if self._is_athena else {"optics"}
        if not (self._is_athena or self._link.has(PPG[0])):
            refused.add("ppg")
        # Nobody waits for what this model has only in name.
        silent = _OPTIONAL - wanted | refused
        model = model_of(serial) or ("Muse S Athena" if self._is_athena else "")
        info = DeviceInfo("", model, serial, text_of(version, "fw"))
        return Opened(info, frozenset(silent), frozenset(refused), denied)

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
        known = ATHENA_PRESETS if self._is_athena else CLASSIC_PRESETS
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

    async def _subscribe(self, sources: Mapping[str, Sequence[str]]) -> dict[str, str]:
        """Subscribe to what sends each stream; return why some are refused.

        Raises
        ------
        AttError
            All are refused.
        TransportError
            ``LOST`` or ``SILENT``.
        """
        denied: dict[str, str] = {}
        for name, uuids in sources.items():
            try:
                for uuid in uuids:
                    await self._link.subscribe(uuid)
            except AttError as error:
                denied[name] = f"nobody may subscribe to it: ATT error 0x{error.code:02X}"
                if len(denied) == len(sources):
                    raise
                # Of some channels alone it would be another signal.
                for uuid in uuids:
                    with suppress(AttError):
                        await self._link.unsubscribe(uuid)
        return denied

    def _sources(self, wanted: frozenset[str]) -> Mapping[str, Sequence[str]]:
        """Return by data name the characteristics that send what is wanted."""
        if self._is_athena:
            return {"eeg": [uuid for uuid in FRAMES if "notify" in self._link.properties(uuid)]}
        return {
            "eeg": EEG,
            **({"aux": [AUX]} if "aux" in wanted else {}),
            **({"ppg": PPG} if "ppg" in wanted else {}),
            "acc": [ACC],
            "gyro": [GYRO],
            "bat": [TELEMETRY],
        }

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
