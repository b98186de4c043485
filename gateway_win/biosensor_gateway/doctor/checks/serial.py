"""Checks that the serial ports of the settings are there and may be opened.

No port is opened: opening a Bluetooth port makes the radio connect.
"""

from __future__ import annotations

import asyncio
import contextlib
import getpass
import os
import re
import sys
from collections.abc import Collection, Iterator
from pathlib import Path

from biosensor_common.doctor.finding import Finding, error, ok, warning
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.device_kinds import serial_ports

_ADDRESS = re.compile(r"[0-9A-Fa-f]{2}(?::[0-9A-Fa-f]{2}){5}")
_PAIR = "pair or plug in the device and switch it on, then: biosensor-gateway scan"


def examine(context: Context) -> Iterator[Finding]:
    """Look at each port."""
    named = serial_ports(context.enabled)
    if not named:
        yield ok("no device of the settings has a serial port")
        return
    from biosensor_gateway.transports.serial_ports import (  # brings D-Bus
        serial_ports as present_ports,
    )

    present = asyncio.run(present_ports())
    known = {each.port.upper() for each in present} | {
        each.remote_address.upper() for each in present
    }
    for port, sensor in named.items():
        if _ADDRESS.fullmatch(port):
            yield _paired(port, sensor, known)
        elif sys.platform == "win32":
            yield _windows_port(port, sensor, known)
        else:
            yield device_file(Path(port), sensor)


def _paired(address: str, sensor: str, known: Collection[str]) -> Finding:
    if address.upper() in known:
        return ok(f"{sensor}: {address} is paired")
    return warning(
        f"{sensor}: {address} is not known as a paired device with a serial service",
        "Devices of classic Bluetooth connect only to computers that they are paired with.",
        f"bluetoothctl pair {address}"
        if sys.platform == "linux"
        else "pair it in the system's Bluetooth settings",
    )


def _windows_port(port: str, sensor: str, known: Collection[str]) -> Finding:
    if port.upper() in known:
        return ok(f"{sensor}: {port} is there")
    return _absent(port, sensor)


def device_file(path: Path, sensor: str) -> Finding:
    """Judge a port that is a file."""
    if not path.exists():
        return _absent(str(path), sensor)
    if os.access(path, os.R_OK | os.W_OK):
        return ok(f"{sensor}: {path} is there and may be opened")
    group = _group(path)
    return error(
        f"{sensor}: {path} may not be opened by you",
        f"It belongs to the group {group}; {getpass.getuser()} is not in it, or was not when the "
        "session began.",
        f'sudo usermod -aG {group} "$USER", then log out and in',
    )


def _absent(port: str, sensor: str) -> Finding:
    return error(
        f"{sensor}: there is no port {port}",
        "The agent goes on looking for it, and streams nothing of this device until it is there.",
        f"{_PAIR}\nand correct port, if it has another name now: biosensor-gateway config edit",
    )


def _group(path: Path) -> str:
    if sys.platform != "win32":
        # A group may have no name, and a port may have gone.
        with contextlib.suppress(KeyError, OSError):
            return path.group()
    return "dialout"
