"""Driver for Muse headbands, with their settings and presets."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Literal, NamedTuple

from pydantic import Field

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.ble_session import BleSession
from biosensor_gateway.devices.driver import Connected, DriverEntry, Found, own_settings
from biosensor_gateway.devices.muse.driver import protocol
from biosensor_gateway.devices.muse.driver.emitter import MuseEmitter
from biosensor_gateway.devices.muse.driver.protocol import (
    ACC,
    AUX,
    CONTROL,
    EEG,
    FRAMES,
    GYRO,
    PPG,
    SERVICE,
    TELEMETRY,
    Answer,
    Answers,
    text_of,
)
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink, Notification
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import AttError
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

KIND = "Muse"
ADVICE = "switch it on (its lights run), and disconnect it from phones and other programs"
_NAME = re.compile(r"Muse(?:S|Athena| Athena)?-(?P<number>\w+)")
_SEPARATORS = re.compile(r"[^0-9A-Fa-f]")

KEEP_ALIVE_S = 10.0
"""Without commands, headbands end the stream after some minutes (muse-lsl, issue 184)."""
ANSWER_LIMIT_S = 5.0
_ALWAYS = frozenset({"eeg", "acc", "gyro"})
_OPTIONAL = frozenset({"aux", "ppg", "optics"})

# Sources: BrainFlow's list of supported boards for the contents of presets; recordings of an
# Athena in OpenMuse (`tests/test_data`), where two-digit presets have no light; the package
# openble-muse for serial numbers.
_MODELS = {
    "2": "Muse 2016",
    "4": "Muse 2",
    "5": "Muse S",
    "6": "Muse S",
    "7": "Muse S Athena",
}
MUSE_S = frozenset({"5", "6"})


class _Preset(NamedTuple):
    """What a preset contains besides four EEG channels, acceleration and rotation."""

    has_aux: bool  # Whether it has the inputs for additional electrodes.
    light: int  # Number of light channels.


CLASSIC_PRESETS = {
    "p20": _Preset(True, 0),
    "p21": _Preset(False, 0),
    "p50": _Preset(True, 3),
    "p51": _Preset(False, 3),
    "p60": _Preset(True, 3),
    "p61": _Preset(False, 3),
}
"""Presets of headbands before the Athena; the last two are for the Muse S."""
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

Preset = Literal[
    "",
    "p20",
    "p21",
    "p50",
    "p51",
    "p60",
    "p61",
    "p1034",
    "p1035",
    "p1041",
    "p1042",
    "p1043",
    "p1044",
    "p1045",
    "p1046",
]


class MuseSettings(DeviceSettings):
    """Settings of one Muse."""

    device: str = Field(
        default="",
        max_length=64,
        description="Bluetooth address of the headband, as scan shows it, or the four characters "
        "of its name, as in Muse-3A1F; if empty, the only one in range.",
        examples=["3A1F"],
    )
    aux: bool = Field(
        default=False,
        description="Whether the headband sends its auxiliary inputs, for your own electrodes: one "
        "on a Muse 2 or Muse S, four on an Athena.",
    )
    ppg: bool = Field(
        default=True, description="Whether a Muse 2 or Muse S sends its pulse light signals."
    )
    optics: Literal[0, 4, 8, 16] = Field(
        default=16,
        description="Minimum number of light channels that an Athena sends: those between the "
        "eyes, those of the whole forehead, or both with red and ambient light.",
    )
    preset: Preset = Field(
        default="",
        description="The headband's own number for the data it sends, for one that the other "
        "settings do not select; if empty, they select it. In any case, streams that are "
        "switched off are not sent.",
    )


def model_of(serial: str) -> str:
    """Return the model from the serial number; empty if unknown."""
    return _MODELS.get(serial[:1], "")


def classic_preset(serial: str, *, aux: bool, ppg: bool) -> str:
    """Return the preset of a Muse 2 or Muse S."""
    decade = 20 if not ppg else 60 if serial[:1] in MUSE_S else 50
    return f"p{decade if aux else decade + 1}"


def athena_preset(*, aux: bool, light: int) -> str:
    """Return the Athena preset with the fewest channels that contains all requested ones."""
    fitting = [
        (preset.light, preset.has_aux, name)
        for name, preset in ATHENA_PRESETS.items()
        if preset.light >= light and preset.has_aux >= aux
    ]
    return min(fitting)[2]


class _Conversation(BleSession[Notification, str]):
    """The commands and answers on one connection."""

    def __init__(self, link: BleLink) -> None:
        super().__init__(link, self._receive, self.tell, "switch it off and on")
        # Shared by all requests, because a packet may contain the end of one answer and the start
        # of the next.
        self._answers = Answers()
        self._fresh: list[Answer] = []

    async def begin(self) -> None:
        """Subscribe to answers; raises like :meth:`BleLink.subscribe`."""
        # Before the first command, otherwise its answer would be lost.
        await self.link.subscribe(CONTROL)
        self.dialogue.begin()

    async def request(self, command: str, key: str = "rc") -> Answer:
        """Send a command and return its answer.

        Parameters
        ----------
        key
            A field that only this answer has, because an earlier answer may arrive late.

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
            fits = (each for each in self._fresh if key in each or protocol.return_code(each))
            return next(fits, None)

        failure = f"no answer to the command {command}"
        answer = await self.ask(command, match, ANSWER_LIMIT_S, failure)
        code = protocol.return_code(answer)
        if code:
            message = (
                f"{self.link.what} refuses the command {command} ({code}); switch it off and on, "
                "and leave preset empty in its settings"
            )
            raise ProtocolError(ProtocolReason.REFUSED, message)
        return answer

    async def tell(self, command: str) -> None:
        """Send a command without waiting for its answer."""
        await self.link.write(CONTROL, protocol.encode(command), response=False)

    async def _receive(self) -> Sequence[Notification]:
        notification = await self.link.next()
        if notification.uuid == CONTROL:
            first = self._answers.feed(notification.data)
            self._fresh = [] if first is None else [first, *self._answers.complete]
        return (notification,)


class MuseDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    # Silent streams are detected much earlier.
    silence_limit_s = 30.0

    def __init__(
        self, link: BleLink, emitter: MuseEmitter, sink: DeviceSink, settings: MuseSettings
    ) -> None:
        self._link = link
        self._emitter = emitter
        self._sink = sink
        self._settings = settings
        self._conversation = _Conversation(link)
        self._preset = ""
        self._wanted = _ALWAYS
        self._percent: float | None = None

    async def connect(self) -> Connected:
        """Connect and start the wanted streams; see the protocol class."""
        await self._conversation.connect()
        if not self._link.has(CONTROL) or not (self._link.has(EEG[0]) or self._is_athena):
            message = (
                f"{self._link.what} does not offer the services of a Muse of 2016 or later; if "
                "it is one, hold its button for 30 s to reset it"
            )
            raise ProtocolError(ProtocolReason.UNSUPPORTED, message)
        await self._conversation.begin()
        offer = protocol.VERSION_OF_FRAMES if self._is_athena else protocol.VERSION
        version = await self._conversation.request(offer, "fw")
        status = await self._conversation.request(protocol.STATUS, "sn")
        serial = text_of(status, "sn")
        self._preset, wanted = self._chosen(serial)
        self._wanted, self._percent = _ALWAYS | wanted, protocol.battery_percent(status)
        denied = await self._subscribe(self._sources(wanted))
        await self._start()
        refused = {"ppg"} if self._is_athena else {"optics"}
        if not (self._is_athena or self._link.has(PPG[0])):
            refused.add("ppg")
        # Streams that this model does not have are not monitored.
        silent = _OPTIONAL - wanted | refused
        model = model_of(serial) or ("Muse S Athena" if self._is_athena else "")
        info = DeviceInfo("", model, serial, text_of(version, "fw"))
        return Connected(info, silent=silent, refused=frozenset(refused), denied=denied)

    async def stream(self) -> None:
        """Emit data received since connecting; see the protocol class."""
        await self._conversation.stream(self._take, self._emitter.signal_strength, self._keep_alive)

    async def close(self) -> None:
        """Stop the headband without waiting for an answer, and disconnect."""
        await self._conversation.close(lambda: self._conversation.tell(protocol.HALT))

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Restart all streams, because a preset covers all of them; see the protocol class."""
        del streams
        await self._start()

    @property
    def _is_athena(self) -> bool:
        return self._link.has(FRAMES[0])

    async def _start(self) -> None:
        await self._conversation.request(protocol.HALT)
        await self._conversation.request(self._preset)
        # Before the command, because packets may arrive before its answer.
        self._emitter.started(self._wanted, self._percent)
        start = protocol.START_FRAMES if self._is_athena else protocol.START
        await self._conversation.request(start)

    def _chosen(self, serial: str) -> tuple[str, frozenset[str]]:
        """Return the preset and the optional streams in it."""
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
        """Subscribe to the characteristics of each stream; return why some are refused.

        Raises
        ------
        AttError
            If all are refused.
        TransportError
            ``LOST`` or ``SILENT``.
        """
        denied: dict[str, str] = {}
        for name, uuids in sources.items():
            try:
                for uuid in uuids:
                    await self._link.subscribe(uuid)
            except AttError as error:
                denied[name] = f"it does not allow subscriptions: ATT error 0x{error.code:02X}"
                if len(denied) == len(sources):
                    raise
                # A subset of its channels would be a different signal, so all are dropped.
                for uuid in uuids:
                    with suppress(AttError):
                        await self._link.unsubscribe(uuid)
        return denied

    def _sources(self, wanted: frozenset[str]) -> Mapping[str, Sequence[str]]:
        """Return the characteristics of the wanted streams by data name."""
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
            await self._conversation.tell(protocol.KEEP_ALIVE)

    def _take(self, found: Sequence[Notification]) -> None:
        for notification in found:
            if notification.uuid == CONTROL:
                self._sink.heard()
            else:
                self._emitter.take(notification)


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], MuseDriver]:
    """Share the emitter and the device selection between all connections."""
    own = own_settings(MuseSettings, settings)
    emitter = MuseEmitter(sink)
    choice = Choice(identify, KIND, own.device, ADVICE)
    return lambda: MuseDriver(BleLink(choice, sink.clock), emitter, sink, own)


def identify(seen: Advertisement) -> str | None:
    """Return the digits of a name like ``Muse-3A1F`` or ``MuseS-3A1F``; None for other devices.

    Headbands without an advertised name are recognised by their service, but their digits are
    unknown.
    """
    if not seen.name.strip():
        return "" if SERVICE in seen.service_uuids else None
    found = _NAME.fullmatch(seen.name.strip())
    return found["number"] if found else None


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Recognise a Muse."""
    if not isinstance(seen, Advertisement):
        return None
    number = identify(seen)
    if number is None:
        return None
    unit = number or _SEPARATORS.sub("", seen.address)[-4:]
    settings = {"unit": unit, "device": seen.address}
    return Found("muse", seen.name or f"{KIND} without a name", settings, seen.rssi_dbm)


# Fields of the headband's status: chip id, serial number, address, name.
IDENTIFIERS = (re.compile(rb'"(?:id|sn|ma|hn)"\s*:\s*"([^"]{4,64})"'),)
DRIVER = DriverEntry(MuseSettings, _make, recognise=recognise, identifiers=IDENTIFIERS)
