"""A headset as seen by Cortex: search, connection, power and loss."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

_FULL_SCALE_UV = 20 / 39 * 2**14  # 0.51 uV a step at 14 bits
_INSIGHT = ("AF3", "T7", "Pz", "T8", "AF4")
_QUATERNION = ("Q0", "Q1", "Q2", "Q3")
_GYROSCOPE = ("GYROX", "GYROY", "GYROZ")
_FIELDS = ("ACCX", "ACCY", "ACCZ", "MAGX", "MAGY", "MAGZ")


@dataclass(frozen=True, slots=True)
class Model:
    """Properties of a headset of one model and firmware."""

    prefix: str  # Prefix of the headset's id, as in `INSIGHT-A1B2C3D4`.
    mode: str  # Value of `settings.mode`.
    electrodes: tuple[str, ...]  # Electrodes in the order of the columns.
    # eeg_rate, eeg_bits: samples per second and resolution of the ADC.
    eeg_rate: int
    eeg_bits: int
    motion_rate: int  # Samples per second; 0 if the motion sensor is off.
    # Whether it sends angular rates instead of the quaternion, as in older firmware.
    has_gyroscope: bool
    firmware: str  # Version as in the headset object.

    @property
    def motion_sensors(self) -> tuple[str, ...]:
        """Columns of the motion stream after its counter and flag."""
        return (*(_GYROSCOPE if self.has_gyroscope else _QUATERNION), *_FIELDS)

    @property
    def resolution_uv(self) -> float:
        """One step of the ADC [uV]."""
        return _FULL_SCALE_UV / 2**self.eeg_bits


INSIGHT_1 = Model("INSIGHT", "INSIGHT", _INSIGHT, 128, 14, 64, False, "930")
INSIGHT_1_GYRO = Model("INSIGHT", "INSIGHT", _INSIGHT, 128, 14, 128, True, "925")
INSIGHT_2 = Model("INSIGHT2", "INSIGHT", _INSIGHT, 128, 16, 32, False, "a11")


_BANDS = ("theta", "alpha", "betaL", "betaH", "gamma")

Columns = list[str | list[str]]


class Metrics(Enum):
    """Layout of the performance metrics."""

    SEVEN = auto()
    """Seven numbers, without ``isActive``."""
    FOCUS = auto()
    ATTENTION_FIRST = auto()
    ATTENTION_LAST = auto()


@dataclass(frozen=True, slots=True)
class Release:
    """One version of Cortex."""

    version: str  # As in `getCortexInfo`, such as `4.8.32`.
    metrics: Metrics | None = None  # Layout of `met`; None for the usual one of this version.

    @property
    def must_scan(self) -> bool:
        """Whether Cortex searches for headsets only on request."""
        return self._at_least(3, 7)

    @property
    def names_metrics(self) -> bool:
        """Whether the session object lists the performance metrics."""
        return self._at_least(3)

    @property
    def streams(self) -> tuple[str, ...]:
        """Available streams."""
        return ("eeg", "mot", "pow", "met", "dev", *(("eq",) if self._at_least(2, 7) else ()))

    def columns(self, stream: str, model: Model) -> Columns:
        """Return the columns of a stream, as in the reply to a subscription."""
        match stream:
            case "eeg":
                markers = ("MARKERS",) if self._at_least(2, 1) else ()
                lead = ("COUNTER", "INTERPOLATED")
                return [*lead, *model.electrodes, "RAW_CQ", "MARKER_HARDWARE", *markers]
            case "mot":
                return ["COUNTER_MEMS", "INTERPOLATED_MEMS", *model.motion_sensors]
            case "pow":
                return [f"{name}/{band}" for name in model.electrodes for band in _BANDS]
            case "met":
                return self._metric_columns()
            case "dev":
                return self._device_columns(model)
            case _:
                return ["batteryPercent", "overall", "sampleRateQuality", *model.electrodes]

    def _device_columns(self, model: Model) -> Columns:
        if self._at_least(2, 7):
            return ["Battery", "Signal", [*model.electrodes, "OVERALL"], "BatteryPercent"]
        return ["Battery", "Signal", [*model.electrodes]]

    def _metric_columns(self) -> Columns:
        six = ["eng", "exc", "lex", "str", "rel", "int"]
        match self.metrics or self._usual_metrics():
            case Metrics.SEVEN:
                return [*six, "foc"]
            case Metrics.FOCUS:
                return _with_activity([*six, "foc"])
            case Metrics.ATTENTION_FIRST:
                return _with_activity(["attention", *six])
            case Metrics.ATTENTION_LAST:
                return _with_activity([*six, "attention"])

    def _usual_metrics(self) -> Metrics:
        if self._at_least(4):
            return Metrics.ATTENTION_FIRST
        if self._at_least(3):
            return Metrics.ATTENTION_LAST
        return Metrics.FOCUS if self._at_least(2, 2, 1) else Metrics.SEVEN

    def _at_least(self, *number: int) -> bool:
        return tuple(int(part) for part in self.version.split(".")) >= number


def _with_activity(names: list[str]) -> Columns:
    columns: Columns = []
    for name in names:
        # Only the long-term excitement is never inactive.
        columns += [name] if name == "lex" else [f"{name}.isActive", name]
    return columns


Announcement = str | dict[str, str]
"""A warning's message: a text, or an object about a headset or session."""


def warning(code: int, message: Announcement) -> str:
    """Return a warning as JSON."""
    return json.dumps({"jsonrpc": "2.0", "warning": {"code": code, "message": message}})


Warn = Callable[[int, Announcement], None]
"""Sends a warning with code and message to all clients."""

_WRONG_INFORMATION, _CONNECTED, _SCAN_FINISHED = 100, 104, 142
_BEHAVIOURS = {
    _WRONG_INFORMATION: "wrong information",
    _CONNECTED: "headset connected",
}


class Status(Enum):
    """Status of a headset in the list; ABSENT if it is not in the list."""

    ABSENT = ""
    DISCOVERED = "discovered"
    CONNECTING = "connecting"
    CONNECTED = "connected"


@dataclass(frozen=True, slots=True)
class Timing:
    """Durations of Cortex's actions [s]; a real one scans for 20 s."""

    # found_s, scan_s: from the start of a scan until a headset is found, and until the scan ends.
    found_s: float = 0.2
    scan_s: float = 1.0
    connect_s: float = 0.2  # Until a connection is established.
    starting_s: float = 0.3  # Time until a restarted service is ready.


class Headset:
    """One headset and Cortex's connection to it.

    Parameters
    ----------
    must_scan
        If False, it is in the list without a scan.
    """

    def __init__(
        self,
        headset_id: str,
        model: Model,
        timing: Timing,
        *,
        must_scan: bool,
        loop: asyncio.AbstractEventLoop,
        warn: Warn,
    ) -> None:
        self.headset_id = headset_id
        self.model = model
        self._timing = timing
        self._must_scan = must_scan
        self._loop = loop
        self._warn = warn
        self._timers: set[asyncio.TimerHandle] = set()
        self.status = Status.ABSENT
        self.reset()

    def describe(self) -> dict[str, Any]:
        """Return the headset object of the API, which has few fields before the connection."""
        known = self.status is Status.CONNECTED
        model = self.model
        return {
            "connectedBy": "bluetooth",
            "dfuTypes": ["dfuOta"],
            "dongle": "0",
            "firmware": model.firmware,
            "firmwareDisplay": f"0x0{model.firmware}",
            "id": self.headset_id,
            "isDfuMode": False,
            "isVirtual": False,
            "motionSensors": list(model.motion_sensors) if known and model.motion_rate else [],
            "sensors": list(model.electrodes) if known else [],
            "settings": {
                "eegRate": model.eeg_rate if known else 0,
                "eegRes": model.eeg_bits if known else 0,
                "memsRate": model.motion_rate if known else 0,
                "memsRes": 16 if known else 0,
                "mode": model.mode if known else "UNKNOWN",
            },
            "status": self.status.value,
            "virtualHeadsetId": "",
        }

    def reset(self) -> None:
        """Reset to the state after a start of Cortex."""
        self.cancel()
        self.status = Status.ABSENT if self._must_scan else Status.DISCOVERED

    def cancel(self) -> None:
        """Cancel all timers."""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def scan(self) -> None:
        """Start a scan."""
        self._later(self._timing.found_s, self._found)
        self._later(self._timing.scan_s, self._scanned)

    def connect(self) -> None:
        """Connect, or fail with a warning."""
        if self.status is Status.CONNECTED:
            self._say(_CONNECTED)
            return
        self.status = Status.CONNECTING
        self._later(self._timing.connect_s, self._connected)

    def refuse_connect(self, headset_id: str) -> None:
        """Warn that there is no headset with this id."""
        self._say(_WRONG_INFORMATION, headset_id)

    def _found(self) -> None:
        if self.status is Status.ABSENT:
            self.status = Status.DISCOVERED

    def _scanned(self) -> None:
        self._warn(_SCAN_FINISHED, {"behavior": "headset scanning finished"})

    def _connected(self) -> None:
        self.status = Status.CONNECTED
        self._say(_CONNECTED)

    def _say(self, code: int, headset_id: str = "") -> None:
        headset_id = headset_id or self.headset_id
        self._warn(code, {"behavior": _BEHAVIOURS[code], "headsetId": headset_id})

    def _later(self, delay_s: float, action: Callable[[], None]) -> None:
        self._timers = {timer for timer in self._timers if timer.when() > self._loop.time()}
        self._timers.add(self._loop.call_later(delay_s, action))
