"""Checks whether the computer or its Bluetooth adapter may go to sleep during a recording."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from uuid import UUID

from biosensor_common import child
from biosensor_common.doctor.check import Finding, note, ok, warning
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.devices import by_bluetooth_le

ADAPTERS = Path("/sys/class/bluetooth")
_GNOME = "org.gnome.settings-daemon.plugins.power"
_GNOME_KEY = "sleep-inactive-ac-type"
_HELD_OFF = (
    "The agent holds sleep off while a device streams, but not before the first one does, nor if "
    "the lid is closed."
)
_NOT_HELD_OFF = "A recording ends with the sleep, and keep_awake is off in the settings."

# GUID_SLEEP_SUBGROUP and GUID_STANDBY_TIMEOUT of winnt.h.
_SLEEP = UUID("238c9fa8-0aad-41ed-83f4-97be242c8f20")
_STANDBY_TIMEOUT = UUID("29f6c1db-86da-48c5-9fdb-f2b67b1f44da")


def _sleep_timeout_s() -> int | None:
    """Return the idle time in s after which Windows sleeps on mains; 0 for never, None unknown."""
    if sys.platform != "win32":
        return None
    scheme = ctypes.c_void_p()
    seconds = ctypes.c_uint32()
    try:
        library = ctypes.WinDLL("powrprof")
        if library.PowerGetActiveScheme(None, ctypes.byref(scheme)):
            return None
        failed = library.PowerReadACValueIndex(
            None, scheme, _guid(_SLEEP), _guid(_STANDBY_TIMEOUT), ctypes.byref(seconds)
        )
        ctypes.WinDLL("kernel32").LocalFree(scheme)
    except (OSError, AttributeError):
        # Reduced editions of Windows have no power schemes.
        return None
    return None if failed else seconds.value


def _guid(value: UUID) -> ctypes.Array[ctypes.c_char]:
    return ctypes.create_string_buffer(value.bytes_le, len(value.bytes_le))


def power(context: Context) -> Iterator[Finding]:
    """Check sleep, mains and Bluetooth."""
    yield from _sleep(context.keep_awake)
    yield from _battery()
    if sys.platform == "linux":
        yield from adapters(ADAPTERS)
    elif sys.platform == "win32" and by_bluetooth_le(context.enabled):
        yield note(
            "Windows may switch the Bluetooth adapter off to save power",
            "Then the sensors drop out, and come back only by chance.",
            "Device Manager > Bluetooth > the adapter > Properties > Power Management: clear "
            "'Allow the computer to turn off this device'",
        )


def _sleep(keep_awake: bool) -> Iterator[Finding]:
    if sys.platform == "linux":
        after = _linux_sleep()
        fix = f"gsettings set {_GNOME} {_GNOME_KEY} nothing"
    elif sys.platform == "win32":
        after = _windows_sleep()
        fix = "powercfg /change standby-timeout-ac 0"
    else:
        return
    if after is None:
        yield ok("nothing is known to send this computer to sleep by itself")
    elif keep_awake:
        yield note(f"this computer goes to sleep {after}", _HELD_OFF, fix)
    else:
        yield warning(f"this computer goes to sleep {after}", _NOT_HELD_OFF, fix)


def _linux_sleep() -> str | None:
    masked = child.output_of("systemctl", "is-enabled", "sleep.target")
    if masked is not None and masked.strip() == "masked":
        return None
    desktop = child.output_of("gsettings", "get", _GNOME, _GNOME_KEY)
    if desktop is not None and "suspend" in desktop:
        return "when nobody uses it (the desktop's setting for mains)"
    return None


def _windows_sleep() -> str | None:
    seconds = _sleep_timeout_s()
    return f"after {seconds / 60:g} minutes on mains" if seconds else None


def _battery() -> Iterator[Finding]:
    import psutil

    state = None
    # psutil lacks the function on some systems, and containers have no folder of batteries.
    with suppress(AttributeError, OSError):
        state = psutil.sensors_battery()
    if state is not None and state.power_plugged is False:
        yield note(
            f"this computer runs on battery ({state.percent:.0f} percent)",
            "It saves power at the cost of radio and timing, and may go to sleep whatever the "
            "agent asks for.",
            "plug it in",
        )


def adapters(folder: Path) -> Iterator[Finding]:
    """Check the power saving of USB Bluetooth adapters on Linux.

    Parameters
    ----------
    folder
        Has an entry for each adapter, like ``/sys/class/bluetooth``.
    """
    for adapter in sorted(folder.glob("hci*")):
        # The adapter is an interface of the USB device.
        for control in (adapter / "device/../power/control", adapter / "device/power/control"):
            if _is_auto(control):
                yield note(
                    f"the Bluetooth adapter {adapter.name} may be suspended (USB autosuspend)",
                    "Some adapters lose connections by it, or do not come back.",
                    f"echo on | sudo tee {control.resolve()}\nfor good: options btusb "
                    "enable_autosuspend=0 in /etc/modprobe.d/btusb.conf",
                )
                break


def _is_auto(control: Path) -> bool:
    try:
        return control.read_text("ascii").strip() == "auto"
    except (OSError, ValueError):
        return False
