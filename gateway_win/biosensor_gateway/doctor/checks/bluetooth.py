"""Checks that there is a Bluetooth adapter, that it is on and may be used."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterator

from biosensor_common.doctor.finding import Finding, error, note, ok
from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.device_kinds import by_bluetooth_le

LISTEN_S = 2.0
UNSEEN_ON_WINDOWS = (
    "on Windows, sensors that drop a connection or refuse it are paired, and unpaired at its end; "
    "this was not seen with a real sensor yet: `pair` in the sensor's table decides it"
)
_LINUX_FIXES = {
    TransportReason.UNAVAILABLE: "sudo systemctl start bluetooth && rfkill unblock bluetooth && "
    "bluetoothctl power on",
    TransportReason.DENIED: 'sudo usermod -aG bluetooth "$USER", then log out and in',
    TransportReason.BUSY: "bluetoothctl scan off, and close other programs that use Bluetooth",
}
_WINDOWS_FIXES = {
    TransportReason.UNAVAILABLE: "plug the adapter in; Settings > Bluetooth & devices > On",
    TransportReason.DENIED: "Settings > Privacy & security > Radios: let desktop apps use them",
    TransportReason.BUSY: "close other programs that use Bluetooth",
}
_MAC_FIXES = {
    TransportReason.UNAVAILABLE: "System Settings > Bluetooth > On",
    TransportReason.DENIED: "System Settings > Privacy & Security > Bluetooth: allow the terminal",
    TransportReason.BUSY: "close other programs that use Bluetooth",
}
_FIXES = {"win32": _WINDOWS_FIXES, "darwin": _MAC_FIXES}


def examine(context: Context) -> Iterator[Finding]:
    """Listen for a moment."""
    from biosensor_gateway.transports import ble_pairing  # brings bleak, as the next does
    from biosensor_gateway.transports.ble_scanner import scan

    needing = by_bluetooth_le(context.enabled)
    try:
        heard = asyncio.run(scan(LISTEN_S))
    except TransportError as problem:
        yield _unusable(problem, [each.sensor for each in needing])
        return
    amount = "1 device was" if len(heard) == 1 else f"{len(heard)} devices were"
    yield ok(f"Bluetooth is on; {amount} heard in {LISTEN_S:g} s")
    if needing and ble_pairing.PLATFORM == "win32":
        yield ok(UNSEEN_ON_WINDOWS)
    if needing and not heard:
        yield note(
            "nothing at all is heard by Bluetooth",
            "A device that is connected elsewhere, to a phone for instance, or that is off, "
            "cannot be heard.",
            "switch the sensor on, wear it, disconnect it from phones, then: biosensor-gateway "
            "scan",
        )


def _unusable(problem: TransportError, needing: list[str]) -> Finding:
    fix = _FIXES.get(sys.platform, _LINUX_FIXES).get(problem.reason, "biosensor-gateway scan")
    if needing:
        why = f"{', '.join(dict.fromkeys(needing))} cannot be reached without it."
        return error(str(problem), why, fix)
    why = "No device of the settings needs it; the others are not affected."
    return note(str(problem), why, fix)
