"""Translates bleak's errors, by class and code, and decides when a device is paired."""

from __future__ import annotations

import re
import sys
from typing import Annotated, Literal

from bleak.exc import (
    PROTOCOL_ERROR_CODES,
    BleakBluetoothNotAvailableError,
    BleakBluetoothNotAvailableReason,
    BleakDBusError,
    BleakDeviceNotFoundError,
    BleakError,
    BleakGATTProtocolError,
)
from pydantic import BeforeValidator

from biosensor_common.errors import (
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)

_DENIED = frozenset(
    {
        BleakBluetoothNotAvailableReason.DENIED_BY_USER,
        BleakBluetoothNotAvailableReason.DENIED_BY_SYSTEM,
        BleakBluetoothNotAvailableReason.DENIED_BY_UNKNOWN,
    }
)

_DBUS_REASONS = {
    "org.bluez.Error.AuthenticationCanceled": TransportReason.DENIED,
    "org.bluez.Error.AuthenticationFailed": TransportReason.DENIED,
    "org.bluez.Error.AuthenticationRejected": TransportReason.DENIED,
    "org.bluez.Error.AuthenticationTimeout": TransportReason.DENIED,
    "org.bluez.Error.InProgress": TransportReason.BUSY,
    "org.bluez.Error.NotAuthorized": TransportReason.DENIED,
    "org.bluez.Error.NotReady": TransportReason.UNAVAILABLE,
    "org.freedesktop.DBus.Error.AccessDenied": TransportReason.DENIED,
    "org.freedesktop.DBus.Error.NameHasNoOwner": TransportReason.UNAVAILABLE,
    "org.freedesktop.DBus.Error.ServiceUnknown": TransportReason.UNAVAILABLE,
}

_ADVICE = {
    TransportReason.BUSY: "Bluetooth is already busy with it; close other programs that use it, or "
    "switch Bluetooth off and on",
    TransportReason.DENIED: "the system does not allow this program to use Bluetooth; allow it in "
    "the system's settings",
    TransportReason.UNAVAILABLE: "Bluetooth is unavailable; plug in or switch on the radio",
}

_FAILURES = {
    TransportReason.LOST: "this computer's Bluetooth system fails",
    TransportReason.DENIED: "pairing fails; remove the device from the computer's Bluetooth "
    "settings and try again",
}

# How bleak puts it when its own picture of BlueZ has lost the device before BlueZ is asked.
_NOT_IN_BLUEZ = re.compile(r"device '\w+' not found")


# BlueZ's words for "insufficient authentication", "insufficient encryption" and "encryption key
# too short" [src/gatt-client.c]; it tells neither the code nor which of them.
_NOT_PAIRED = ("org.bluez.Error.NotPermitted", "Not paired")
_INSUFFICIENT_AUTHENTICATION, _INSUFFICIENT_ENCRYPTION = 0x05, 0x0F
UNLIKELY_ERROR = 0x0E
"""What is left of these where BlueZ has tried to pair by itself, and could not."""
PairMode = Literal["auto", "yes", "no"]
PLATFORM = sys.platform
EARLY_DROP_S = 5.0
"""Who drops a host that is not paired does so at once."""


class AttError(ProtocolError):
    """The device answered a request with an error of the attribute protocol."""

    def __init__(self, code: int, what: str) -> None:
        meaning = PROTOCOL_ERROR_CODES.get(code, "unknown code")
        message = f"{what}: the device refuses the request (ATT error 0x{code:02X}, {meaning})"
        super().__init__(ProtocolReason.REFUSED, message)
        # Error code of the ATT_ERROR_RSP [1]_: 0x05 needs pairing, 0x0F encryption, 0xFD means that
        # notifications are not configured; 0x80 to 0x9F are specific to the device.
        self.code = code

    @property
    def wants_pairing(self) -> bool:
        """Whether the device only answers paired hosts."""
        return self.code in (_INSUFFICIENT_AUTHENTICATION, _INSUFFICIENT_ENCRYPTION)


def att_code(error: Exception) -> int | None:
    """Return the ATT error code of a device's refusal; None for any other error."""
    if isinstance(error, BleakGATTProtocolError):
        return error.code.value
    if (
        isinstance(error, BleakDBusError)
        and (error.dbus_error, error.dbus_error_details) == _NOT_PAIRED
    ):
        return _INSUFFICIENT_AUTHENTICATION
    return None


def scan_error(error: Exception) -> TransportError:
    """Return the error for a scan that did not start: no radio, radio off, or no permission."""
    reason = _system_reason(error) or TransportReason.UNAVAILABLE
    return TransportError(reason, f"{_ADVICE[reason]} ({_text(error)})")


def late_scan(limit_s: float) -> TransportError:
    """Return the error for a scan that did not start in time, but may start later."""
    message = (
        f"Bluetooth does not start to search within {limit_s:.0f} s; still waiting for its "
        "answer; if none comes, switch Bluetooth off and on"
    )
    return TransportError(TransportReason.UNAVAILABLE, message)


def connect_error(what: str, error: Exception) -> TransportError:
    """Return the error for a device in range that could not be connected."""
    reason = _system_reason(error)
    if reason is not None:
        return TransportError(reason, f"{what}: {_ADVICE[reason]} ({_text(error)})")
    message = f"{what}: seen, but it does not connect ({_text(error)}); is it near and free?"
    return TransportError(TransportReason.ABSENT, message)


def request_error(
    what: str, error: Exception, failure: TransportReason, limit_s: float
) -> TransportError | AttError:
    """Return the error for a failed request to a connected device.

    Parameters
    ----------
    failure
        ``LOST`` or ``DENIED``: the reason if the device itself did not refuse.
    limit_s
        The time limit that was exceeded.
    """
    code = att_code(error)
    if code is not None:
        return AttError(code, what)
    if isinstance(error, TimeoutError):
        message = f"{what}: connected, but no answer within {limit_s:.0f} s"
        return TransportError(TransportReason.SILENT, message)
    return TransportError(failure, f"{what}: {_FAILURES[failure]} ({_text(error)})")


def is_forgotten(error: Exception) -> bool:
    """Return whether the system forgot the device between the scan and the connection.

    BlueZ forgets it half a minute after the scan; another scan finds it again.
    """
    if isinstance(error, BleakDeviceNotFoundError):
        return True
    return isinstance(error, BleakError) and _NOT_IN_BLUEZ.fullmatch(str(error)) is not None


def _system_reason(error: Exception) -> TransportReason | None:
    """Return the reason if this computer and not the device causes the error; else None."""
    if isinstance(error, BleakBluetoothNotAvailableError):
        denied = error.reason in _DENIED
        return TransportReason.DENIED if denied else TransportReason.UNAVAILABLE
    if isinstance(error, BleakDBusError):
        return _DBUS_REASONS.get(error.dbus_error)
    return TransportReason.DENIED if isinstance(error, PermissionError) else None


def _text(error: Exception) -> str:
    return str(error) or type(error).__name__


def _of_switch(value: object) -> object:
    """Convert a switch to a mode: on pairs first, off pairs if the device requires it."""
    if isinstance(value, bool):
        return "yes" if value else "auto"
    return value


PairSetting = Annotated[PairMode, BeforeValidator(_of_switch)]
"""Type of the setting ``pair`` of a device."""
PAIR_DESCRIPTION = (
    "auto pairs when the device demands it or, on Windows, drops a connection immediately; yes "
    "pairs before each connection; no never pairs, for a device that was paired in the system's "
    "settings."
)


class Pairing:
    """Knowledge about the pairing of one device; shared by all its connections.

    It does not call the system, so that the rules for Windows can be tested anywhere. They are
    based on reports of users of Windows 11 and were not observed here yet: straps with new firmware
    answer "insufficient authentication" to a host that is not paired, or drop the connection during
    service discovery [1]_ [2]_; a pairing that outlives the connection makes the next one fail
    [1]_; and services that Windows has cached belong to an earlier connection [3]_.

    Parameters
    ----------
    platform
        A value of ``sys.platform``; by default this one.

    References
    ----------
    .. [1] https://github.com/hbldh/bleak/issues/1943
    .. [2] https://github.com/polarofficial/polar-ble-sdk/issues/774
    .. [3] https://github.com/hbldh/bleak/issues/2017
    """

    def __init__(self, mode: PairMode = "auto", platform: str = "") -> None:
        self._mode = mode
        self._is_windows = (platform or PLATFORM) == "win32"
        self._is_ours = False
        self.comes_first = mode == "yes"

    @property
    def uses_known_services(self) -> bool:
        """Whether the system may use its cached services instead of asking the device."""
        return not self._is_windows

    @property
    def ends_with_connection(self) -> bool:
        """Whether to unpair before disconnecting, because Windows cannot reuse the pairing."""
        return self._is_windows and self._is_ours

    def helps(self, error: GatewayError, *, is_unanswered: bool) -> bool:
        """Whether to connect again and pair, because the error may come from a missing pairing.

        BlueZ may not pass on the device's answer: then the first requests fail with another error,
        or get no answer.

        Parameters
        ----------
        is_unanswered
            A request was made that the device may refuse to a host that is not paired, and no
            such request has succeeded yet.
        """
        if self._mode == "no":
            return False
        if isinstance(error, AttError):
            return error.wants_pairing or (error.code == UNLIKELY_ERROR and is_unanswered)
        return (
            isinstance(error, TransportError)
            and error.reason is TransportReason.SILENT
            and is_unanswered
        )

    def note_demand(self) -> None:
        """Note that the device requires pairing; on Windows, which forgets it, pair first then."""
        self.comes_first = self.comes_first or self._is_windows

    def note_drop(self, after_s: float) -> None:
        """Note that a device in range ended a connection, or refused it.

        Parameters
        ----------
        after_s
            Seconds since the connection; 0 if it was refused.
        """
        if self._is_windows and self._mode == "auto" and not self._is_ours:
            # Pairing may fail, and so may not pairing: when they alternate, one of them works.
            self.comes_first = after_s < EARLY_DROP_S and not self.comes_first

    def note_paired(self) -> None:
        """Note that the system has paired the device."""
        self._is_ours = True

    def note_unpaired(self) -> None:
        """Note that the system has unpaired the device."""
        self._is_ours = False
