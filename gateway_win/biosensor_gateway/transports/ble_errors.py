"""Translates bleak's errors, by class and by code where there is one."""

from __future__ import annotations

import re

from bleak.exc import (
    PROTOCOL_ERROR_CODES,
    BleakBluetoothNotAvailableError,
    BleakBluetoothNotAvailableReason,
    BleakDBusError,
    BleakDeviceNotFoundError,
    BleakError,
    BleakGATTProtocolError,
)

from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError, TransportReason

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
    TransportReason.BUSY: "Bluetooth is busy with it already; close other programs that use it, "
    "or switch Bluetooth off and on",
    TransportReason.DENIED: "the system refuses Bluetooth to this program; allow it there",
    TransportReason.UNAVAILABLE: "Bluetooth is unavailable; plug in or switch on the radio",
}

_FAILURES = {
    TransportReason.LOST: "the Bluetooth system of this computer fails",
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


class AttError(ProtocolError):
    """The device answered a request with an error of the attribute protocol.

    Attributes
    ----------
    code
        Error code of the ATT_ERROR_RSP [1]_: 0x05 needs pairing, 0x0F encryption, 0xFD
        means that notifications are not configured; 0x80 to 0x9F are the device's own.

    .. [1] Bluetooth Core Specification 5.2, volume 3, part F, 3.4.1.1.
    """

    def __init__(self, code: int, what: str) -> None:
        meaning = PROTOCOL_ERROR_CODES.get(code, "unknown code")
        message = f"{what}: the device refuses the request (ATT error 0x{code:02X}, {meaning})"
        super().__init__(ProtocolReason.REFUSED, message)
        self.code = code

    @property
    def wants_pairing(self) -> bool:
        """Whether the device answers only who is paired."""
        return self.code in (_INSUFFICIENT_AUTHENTICATION, _INSUFFICIENT_ENCRYPTION)


def att_code(error: Exception) -> int | None:
    """Return the ATT error code of a device's refusal, None if the error is another one."""
    if isinstance(error, BleakGATTProtocolError):
        return error.code.value
    if (
        isinstance(error, BleakDBusError)
        and (error.dbus_error, error.dbus_error_details) == _NOT_PAIRED
    ):
        return _INSUFFICIENT_AUTHENTICATION
    return None


def scan_error(error: Exception) -> TransportError:
    """Tell why a scan did not start: no radio, radio off, or no permission."""
    reason = _system_reason(error) or TransportReason.UNAVAILABLE
    return TransportError(reason, f"{_ADVICE[reason]} ({_text(error)})")


def late_scan(limit_s: float) -> TransportError:
    """Tell that a scan has not begun in time; it may begin yet."""
    message = (
        f"Bluetooth does not begin to search within {limit_s:.0f} s; the answer is waited for; "
        "if none comes, switch Bluetooth off and on"
    )
    return TransportError(TransportReason.UNAVAILABLE, message)


def connect_error(what: str, error: Exception) -> TransportError:
    """Tell why a device that was seen could not be connected."""
    reason = _system_reason(error)
    if reason is not None:
        return TransportError(reason, f"{what}: {_ADVICE[reason]} ({_text(error)})")
    message = f"{what}: seen, but it does not connect ({_text(error)}); is it near and free?"
    return TransportError(TransportReason.ABSENT, message)


def request_error(
    what: str, error: Exception, failure: TransportReason, limit_s: float
) -> TransportError | AttError:
    """Tell why a device that is connected did not do what it was asked.

    Parameters
    ----------
    failure
        ``LOST`` or ``DENIED``: what it means when the device itself has refused nothing.
    limit_s
        How long it was waited for.
    """
    code = att_code(error)
    if code is not None:
        return AttError(code, what)
    if isinstance(error, TimeoutError):
        message = f"{what}: connected, but no answer within {limit_s:.0f} s"
        return TransportError(TransportReason.SILENT, message)
    return TransportError(failure, f"{what}: {_FAILURES[failure]} ({_text(error)})")


def is_forgotten(error: Exception) -> bool:
    """Tell whether the system forgot the device between the scan and the connection.

    BlueZ does, half a minute after the scan; another scan brings the device back.
    """
    if isinstance(error, BleakDeviceNotFoundError):
        return True
    return isinstance(error, BleakError) and _NOT_IN_BLUEZ.fullmatch(str(error)) is not None


def _system_reason(error: Exception) -> TransportReason | None:
    """Return a reason that lies in this computer, not in the device; None if there is none."""
    if isinstance(error, BleakBluetoothNotAvailableError):
        denied = error.reason in _DENIED
        return TransportReason.DENIED if denied else TransportReason.UNAVAILABLE
    if isinstance(error, BleakDBusError):
        return _DBUS_REASONS.get(error.dbus_error)
    return TransportReason.DENIED if isinstance(error, PermissionError) else None


def _text(error: Exception) -> str:
    return str(error) or type(error).__name__
