"""How BlueZ words what goes wrong (its src/error.c and src/gatt-client.c)."""

from __future__ import annotations

from bumble.att import ATT_Error

_FAILED = "org.bluez.Error.Failed"
_ATT_ERRORS = {
    0x02: ("org.bluez.Error.NotPermitted", "Read not permitted"),
    0x03: ("org.bluez.Error.NotPermitted", "Write not permitted"),
    0x06: ("org.bluez.Error.NotSupported", "Not Supported"),
    0x07: ("org.bluez.Error.InvalidArguments", "Invalid offset"),
    0x08: ("org.bluez.Error.NotAuthorized", "Not Authorized"),
    0x0D: ("org.bluez.Error.InvalidArguments", "Invalid Length"),
    0xFD: ("org.bluez.Error.ImproperlyConfigured", "Improperly Configured"),
}
_UNLIKELY = 0x0E
# BlueZ does not pass these on as such. It tries to raise the link's security, which fails where
# no agent is registered, as on a machine without a desktop; then it words them, or nothing but
# the failure.
_INSUFFICIENT_SECURITY = frozenset({0x05, 0x0C, 0x0F})
_NOT_PAIRED = ("org.bluez.Error.NotPermitted", "Not paired")


class BluezError(Exception):
    """An error reply.

    Attributes
    ----------
    name
        Of the D-Bus error.
    text
    """

    def __init__(self, name: str, text: str) -> None:
        super().__init__(name, text)
        self.name = name
        self.text = text


def failed(text: str) -> BluezError:
    """Return the error for everything that has no name of its own."""
    return BluezError(_FAILED, text)


def not_ready() -> BluezError:
    """Return the error of an adapter that is switched off."""
    return BluezError("org.bluez.Error.NotReady", "Resource Not Ready")


def not_connected() -> BluezError:
    """Return the error of a request to a device that is not connected."""
    return BluezError("org.bluez.Error.NotConnected", "Not Connected")


def in_progress() -> BluezError:
    """Return the error of something that was asked for already."""
    return BluezError("org.bluez.Error.InProgress", "Operation already in progress")


def not_supported() -> BluezError:
    """Return the error of a characteristic that cannot notify."""
    return BluezError("org.bluez.Error.NotSupported", "Operation is not supported")


def unknown_object(path: str) -> BluezError:
    """Return the error of an object that does not exist, or not any more."""
    return BluezError("org.freedesktop.DBus.Error.UnknownObject", f"No such object path '{path}'")


def att_error(error: ATT_Error, *, words_security: bool) -> BluezError:
    """Translate an ATT error response."""
    code = error.error_code
    if code in _INSUFFICIENT_SECURITY:
        if words_security:
            return BluezError(*_NOT_PAIRED)
        code = _UNLIKELY
    if code in _ATT_ERRORS:
        return BluezError(*_ATT_ERRORS[code])
    return failed(f"Operation failed with ATT error: 0x{code:02x}")


def request_lost() -> BluezError:
    """Return the error of a request during which the link went."""
    return failed(f"Operation failed with ATT error: 0x{_UNLIKELY:02x}")
