"""A headset as Cortex sees it: looked for, connected to, switched off, lost."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from biosensor_gateway.devices.emotiv_insight.simulator.models import Model
from biosensor_gateway.devices.emotiv_insight.simulator.warnings import Announcement

Warn = Callable[[int, Announcement], None]
"""Tells every client of a warning: its code and message."""

_WRONG_INFORMATION, _CANNOT_CONNECT, _TIMED_OUT = 100, 101, 102
_LOST, _CONNECTED, _SCAN_FINISHED = 103, 104, 142
_BEHAVIOURS = {
    _WRONG_INFORMATION: "wrong information",
    _CANNOT_CONNECT: "cannot connect",
    _TIMED_OUT: "connecting timeout",
    _LOST: "headset disconnected, no data",
    _CONNECTED: "headset connected",
}


class Status(Enum):
    """Of a headset in the list; one that is not in the list is ABSENT."""

    ABSENT = ""
    DISCOVERED = "discovered"
    CONNECTING = "connecting"
    CONNECTED = "connected"


@dataclass(frozen=True, slots=True)
class Timing:
    """How long Cortex takes [s]; a real one scans for 20 s.

    Attributes
    ----------
    found_s, scan_s
        From the begin of a scan until a headset is found, and until the scan ends.
    connect_s
        Until a connection stands.
    silence_s
        Without data until a headset counts as lost.
    starting_s
        Until a restarted service is ready.
    """

    found_s: float = 0.2
    scan_s: float = 1.0
    connect_s: float = 0.2
    silence_s: float = 30.0
    starting_s: float = 0.3


class Headset:
    """One headset and Cortex's connection to it.

    Parameters
    ----------
    is_virtual
        A headset of the vendor's own simulator, whose end Cortex never notices.
    must_scan
        False: it is in the list without a scan.
    loop
        For its timers.
    lost
        Called when the connection has ended.
    """

    def __init__(
        self,
        headset_id: str,
        model: Model,
        timing: Timing,
        *,
        is_virtual: bool,
        must_scan: bool,
        loop: asyncio.AbstractEventLoop,
        warn: Warn,
        lost: Callable[[], None],
    ) -> None:
        self.headset_id = headset_id
        self.model = model
        self.is_virtual = is_virtual
        self.is_on = True
        self._timing = timing
        self._must_scan = must_scan
        self._loop = loop
        self._warn = warn
        self._lost = lost
        self._timers: set[asyncio.TimerHandle] = set()
        self._silence: asyncio.TimerHandle | None = None
        self._connect_failure: int | None = None
        self.status = Status.ABSENT
        self.reset()

    @property
    def delivers(self) -> bool:
        """Tell whether its data reach Cortex."""
        return self.is_on and self.status is Status.CONNECTED

    def describe(self) -> dict[str, Any]:
        """Return the headset object of the API; before the connection it says little."""
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
            "isVirtual": self.is_virtual,
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
        """Be as unknown to Cortex as after its start."""
        self.cancel()
        self.status = Status.ABSENT if self._must_scan else Status.DISCOVERED

    def cancel(self) -> None:
        """Let nothing happen any more that is still to come."""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
        self._stop_waiting()

    def scan(self) -> None:
        """Look for the headset."""
        self._later(self._timing.found_s, self._found)
        self._later(self._timing.scan_s, self._scanned)

    def connect(self) -> None:
        """Connect, or fail with a warning."""
        if self.status is Status.CONNECTED:
            self._say(_CONNECTED)
            return
        self.status = Status.CONNECTING
        self._later(self._timing.connect_s, self._connected)

    def fail_next_connect(self, code: int) -> None:
        """Let the next connection end with this warning."""
        self._connect_failure = code

    def refuse_connect(self, headset_id: str) -> None:
        """Tell that there is no headset of this id to connect to."""
        self._say(_WRONG_INFORMATION, headset_id)

    def disconnect(self) -> None:
        """End the connection; the headset stays in the list."""
        if self.status is Status.CONNECTED:
            self.status = Status.DISCOVERED
            self._lost()

    def switch_off(self, *, is_noticed: bool) -> None:
        """Send nothing from now on; Cortex notices only by the silence, or never."""
        self.is_on = False
        if self.status is Status.DISCOVERED:
            self.status = Status.ABSENT
        if self.status is Status.CONNECTED and is_noticed and not self.is_virtual:
            self._silence = self._loop.call_later(self._timing.silence_s, self._give_up)

    def switch_on(self) -> None:
        """Send again; a headset that was given up must be found and connected to anew."""
        self.is_on = True
        self._stop_waiting()
        if self.status is Status.ABSENT and not self._must_scan:
            self.status = Status.DISCOVERED

    def _found(self) -> None:
        if self.is_on and self.status is Status.ABSENT:
            self.status = Status.DISCOVERED

    def _scanned(self) -> None:
        self._warn(_SCAN_FINISHED, {"behavior": "headset scanning finished"})

    def _connected(self) -> None:
        failure, self._connect_failure = self._connect_failure, None
        if failure is None and not self.is_on:
            failure = _TIMED_OUT
        self.status = Status.CONNECTED if failure is None else Status.DISCOVERED
        self._say(_CONNECTED if failure is None else failure)

    def _give_up(self) -> None:
        self.status = Status.ABSENT
        self._say(_LOST)
        self._lost()

    def _say(self, code: int, headset_id: str = "") -> None:
        headset_id = headset_id or self.headset_id
        self._warn(code, {"behavior": _BEHAVIOURS[code], "headsetId": headset_id})

    def _stop_waiting(self) -> None:
        if self._silence is not None:
            self._silence.cancel()
            self._silence = None

    def _later(self, delay_s: float, action: Callable[[], None]) -> None:
        self._timers = {timer for timer in self._timers if timer.when() > self._loop.time()}
        self._timers.add(self._loop.call_later(delay_s, action))
