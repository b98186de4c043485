"""Driver for BrainFlow boards, which are read by a separate process."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field
from pylsl import local_clock

from biosensor_common import child
from biosensor_common.errors import (
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.naming import AGENT, NODE
from biosensor_common.spec import SensorSpec, is_data_name
from biosensor_gateway.devices import registry
from biosensor_gateway.devices.brainflow import (
    NAME,
    BoardStream,
    Description,
    board_spec,
    board_streams,
)
from biosensor_gateway.devices.brainflow.driver.emitter import (
    COUNTS_UP_TO,
    Frames,
    OwnClock,
    PresetEmitter,
    Rows,
    Told,
)
from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.settings.models import DeviceSettings, ShortText
from biosensor_gateway.transports.link import Early, Received
from biosensor_gateway.transports.tap import is_replaced
from biosensor_gateway.transports.threads import Traffic, in_daemon_thread

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_BOARD = "_BOARD"


def _taken() -> set[str]:
    return {AGENT, NODE, *registry.sensor_names()} - {NAME}


def _name(value: str) -> str:
    if value and (not is_data_name(value) or value in _taken()):
        raise ValueError(
            "should be lower-case letters, digits and single _ , such as lab_cyton, and not "
            "another sensor's name"
        )
    return value


def _board(value: str) -> str:
    if not (value.isascii() and value.isupper() and is_data_name(value.lower())):
        raise ValueError("should be BrainFlow's name of the board, such as CYTON_BOARD")
    return value


class BrainFlowSettings(DeviceSettings):
    """Settings of one board."""

    board: Annotated[str, AfterValidator(_board)] = Field(
        description="BrainFlow's name of the board.", examples=["SYNTHETIC_BOARD"]
    )
    name: Annotated[ShortText, AfterValidator(_name)] = Field(
        default="",
        description="The board's name in topics; if empty, BrainFlow's name in lower case: "
        "CYTON_BOARD has /biosensors/cyton/...",
    )
    electrodes: Literal["", "eeg", "ecg", "emg", "eog"] = Field(
        default="",
        description="What the electrodes measure, because most boards do not know; if empty, the "
        "first of eeg, ecg, emg and eog that the board can have.",
    )
    python: str = Field(
        default="",
        description="Full path of the Python that has BrainFlow. If empty, the one that this "
        "program runs in; the installed program has none and needs this setting.",
    )
    serial_port: str = Field(
        default="", description="For boards with a dongle or cable, such as COM3 or /dev/ttyUSB0."
    )
    mac_address: str = Field(default="", description="For Bluetooth boards that need it.")
    serial_number: str = Field(
        default="", description="Of the device, or its Bluetooth name, where a board needs it."
    )
    ip_address: str = Field(default="", description="For boards on the network.")
    ip_port: int = Field(default=0, ge=0, le=65535, description="For boards on the network.")
    timeout_s: int = Field(
        default=0,
        ge=0,
        le=600,
        description="How long BrainFlow looks for it; 0 leaves the choice to BrainFlow.",
    )
    other_info: str = Field(
        default="", description="The value that BrainFlow's page on the board calls other_info."
    )
    file: str = Field(
        default="",
        description="Recording for PLAYBACK_FILE_BOARD, which is played instead of a board.",
    )
    master_board: str = Field(
        default="", description="The board that recorded it, such as CYTON_BOARD."
    )
    config: tuple[str, ...] = Field(
        default=(),
        strict=False,
        max_length=64,
        description="Texts sent to configure the board before it starts, in this order.",
    )
    rate_hz: float = Field(
        default=0.0,
        ge=0,
        le=100_000,
        allow_inf_nan=False,
        description="Samples per second, if config changes the rate that BrainFlow reports; 0 uses "
        "BrainFlow's rate.",
    )

    @property
    def sensor_name(self) -> str:
        """Its name in streams and topics."""
        if self.name:
            return self.name
        slug = self.board.removesuffix(_BOARD).lower()
        return f"{NAME}_{slug}" if slug in _taken() else slug

    @property
    def parameters(self) -> dict[str, str | int]:
        """The fields of BrainFlow's input parameters that are set."""
        fields: dict[str, str | int] = {
            "serial_port": self.serial_port,
            "mac_address": self.mac_address,
            "serial_number": self.serial_number,
            "ip_address": self.ip_address,
            "ip_port": self.ip_port,
            "timeout": self.timeout_s,
            "other_info": self.other_info,
            "file": self.file,
            "master_board": self.master_board,
        }
        return {name: value for name, value in fields.items() if value}


_READ_BYTES = 65536
_END_LIMIT_S = 3.0

_OUTSIDE = "biosensor_gateway.devices.brainflow.outside"
_DESCRIBE_LIMIT_S = 20.0
_MISSING = "missing"


def start(settings: BrainFlowSettings, command: str) -> subprocess.Popen[bytes]:
    """Start the program in ``outside`` with pipes for input and output.

    Raises
    ------
    TransportError
        ``UNAVAILABLE`` if the Python does not exist.
    """
    program = [str(_python(settings)), "-I", str(files(_OUTSIDE) / "board.py"), command]
    try:
        return child.start(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    except OSError as error:
        message = f"{program[0]} cannot be started ({error.strerror or error}); is python right?"
        raise TransportError(TransportReason.UNAVAILABLE, message) from error


def _order(settings: BrainFlowSettings, presets: tuple[int, ...] = ()) -> bytes:
    """Return the JSON line with the program's job."""
    told = {
        "board": settings.board,
        "parameters": settings.parameters,
        "config": settings.config,
        "presets": presets,
    }
    return json.dumps(told).encode() + b"\n"


def described(settings: BrainFlowSettings) -> Mapping[int, Description]:
    """Return BrainFlow's description of a board by preset; queried once per board.

    Raises
    ------
    TransportError, ProtocolError
        As for :func:`refusal`.
    """
    return _described(settings.python, settings.board, settings.master_board)


@lru_cache
def _described(python: str, board: str, master_board: str) -> Mapping[int, Description]:
    asked = BrainFlowSettings(
        sensor="brainflow", unit="-", board=board, python=python, master_board=master_board
    )
    process = start(asked, "describe")
    try:
        output, _ = process.communicate(_order(asked), _DESCRIBE_LIMIT_S)
        answer: dict[str, Any] = json.loads(output)
    except (subprocess.TimeoutExpired, ValueError) as error:
        process.kill()
        process.communicate()
        message = f"BrainFlow did not report what {board} has; does it work in {_python(asked)}?"
        raise TransportError(TransportReason.UNAVAILABLE, message) from error
    if "error" in answer:
        raise refusal(asked, answer)
    return {int(preset): description for preset, description in answer["presets"].items()}


def refusal(
    settings: BrainFlowSettings, answer: Mapping[str, Any]
) -> TransportError | ProtocolError:
    """Return the user's error for an ``error`` of the program.

    ``UNAVAILABLE`` without BrainFlow; ``REFUSED`` if BrainFlow cannot open the board.
    """
    said = str(answer.get("said", ""))[:200]
    if answer["error"] == _MISSING:
        message = (
            f"BrainFlow is not in {_python(settings)} ({said}); install it with "
            '"pip install biosensor-gateway[brainflow]", or set python to one that has it'
        )
        return TransportError(TransportReason.UNAVAILABLE, message)
    message = (
        f"BrainFlow cannot open {settings.board}: {said}; is it on, and are its settings right?"
    )
    return ProtocolError(ProtocolReason.REFUSED, message)


def _python(settings: BrainFlowSettings) -> Path:
    if settings.python:
        path = Path(settings.python)
        if not path.is_absolute():
            # A bare name could start a program in the current folder.
            message = f"python is {settings.python!r}, not a full path; write it from the root"
            raise TransportError(TransportReason.UNAVAILABLE, message)
        return path
    if getattr(sys, "frozen", False):
        message = (
            "the installed program does not include BrainFlow, whose licence does not allow it; "
            "install Python and BrainFlow separately, and set python to the full path of that "
            "Python"
        )
        raise TransportError(TransportReason.UNAVAILABLE, message)
    return Path(sys.executable)


class ProcessLink:
    """Starts the process, reads from it in a thread, and ends it."""

    def __init__(self, settings: BrainFlowSettings) -> None:
        self._settings = settings
        self._process: subprocess.Popen[bytes] | None = None
        self._traffic = Traffic("BrainFlow", "the process that reads the board has ended")

    async def open(self, presets: tuple[int, ...]) -> None:
        """Start the process and send its job.

        Raises
        ------
        TransportError
            ``UNAVAILABLE`` if the Python does not exist.
        """
        process = await in_daemon_thread(lambda: start(self._settings, "stream"))
        self._process = process
        self._traffic.start(lambda: self._read_forever(process), lambda: self._write(process))
        self._traffic.write(_order(self._settings, presets))

    async def read(self) -> Received:
        """Wait for the next bytes; raise ``LOST`` when the process has ended."""
        return await self._traffic.read()

    async def close(self) -> None:
        """Let the process release the board; kill it if it does not."""
        self._traffic.closing = True
        self._traffic.end_writing()
        if self._process is not None:
            await in_daemon_thread(self._end)

    def _end(self) -> None:
        process = self._process
        assert process is not None
        child.wait_or_kill(process, _END_LIMIT_S)
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


START_LIMIT_S = 60.0
"""BrainFlow searches for Bluetooth boards, for up to half a minute."""
HANGS_S = 5.0
"""The process sends a keep-alive frame every second, whatever its board does."""
# More than fit into the read that reports the start of the board.
_MOST_EARLY = 4096


class BrainFlowDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    silence_limit_s = 10.0

    def __init__(self, settings: BrainFlowSettings, sink: DeviceSink, *, is_declared: bool) -> None:
        self._settings, self._sink = settings, sink
        self._is_declared = is_declared
        self._link = ProcessLink(settings)
        self._frames = Frames()
        self._early = Early[tuple[Rows, float]](_MOST_EARLY)
        self._described: Mapping[int, Description] = {}

    async def connect(self) -> Connected:
        """Start the process, and wait until the board has started."""
        if is_replaced():
            message = "BrainFlow reaches a board by its own library, which no capture can replace"
            raise TransportError(TransportReason.UNAVAILABLE, message)
        self._described = await in_daemon_thread(lambda: described(self._settings))
        if not self._is_declared:
            message = f"BrainFlow now reports what {self._settings.board} has; restart the agent"
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
        """Emit all data received."""
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
            message = "the process that reads the board hangs; it is restarted"
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
                self._sink if preset == 0 else OwnClock(self._sink),
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


def _make(settings: DeviceSettings, sink: DeviceSink) -> Callable[[], BrainFlowDriver]:
    own = own_settings(BrainFlowSettings, settings)
    is_declared = bool(_declare(own).streams)
    return lambda: BrainFlowDriver(own, sink, is_declared=is_declared)


def _declare(settings: DeviceSettings) -> SensorSpec:
    """Return a board's declaration; empty without BrainFlow, which fails when connecting."""
    own = own_settings(BrainFlowSettings, settings)
    try:
        streams = _streams(own, described(own))
    except GatewayError:
        streams = ()
    return board_spec(own.sensor_name, own.board, streams)


DRIVER = DriverEntry(BrainFlowSettings, _make, declare=_declare)
