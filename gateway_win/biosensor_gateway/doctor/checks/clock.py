"""What keeps this computer's time of day right.

LSL's own clock does not depend on it; file dates, the log and the stamps of ROS do.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator

from biosensor_gateway.doctor import programs
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.finding import Finding, note, ok

_KEEPERS = ("chronyd", "ntpd", "ntpsec", "openntpd", "ptp4l", "phc2sys", "systemd-timesyncd")
# The kernel keeps 15 characters of a name.
_KERNEL_NAME = 15
_WHY = (
    "Stamps of ROS messages, logs and file dates of two computers drift apart. Streams within LSL "
    "are not affected: it measures clock offsets itself."
)
_WINDOWS_SERVICE = "w32time"


def examine(_context: Context) -> Iterator[Finding]:
    """Ask the system."""
    if sys.platform == "linux":
        said = programs.output_of("timedatectl", "show", "-p", "NTP", "-p", "NTPSynchronized")
        yield judge(_running(), said or "")
    elif sys.platform == "win32":
        yield _windows()


def judge(running: Iterable[str], timedatectl: str) -> Finding:
    """Judge the programs that run, and what timedatectl shows."""
    keepers = [each for each in _KEEPERS if each[:_KERNEL_NAME] in set(running)]
    lines = [line.partition("=") for line in timedatectl.splitlines()]
    shown = {key: value for key, _, value in lines}
    if not keepers and shown.get("NTP") != "yes":
        return note(
            "nothing keeps this computer's time of day right",
            _WHY,
            "sudo timedatectl set-ntp true\nor install chrony: sudo apt install chrony",
        )
    name = ", ".join(keepers) or "a time service"
    if shown.get("NTPSynchronized") == "no":
        return note(
            f"{name} runs, but the time of day is not synchronised",
            _WHY,
            "connect this computer to its time server, then: timedatectl timesync-status, or "
            "chronyc tracking",
        )
    return ok(f"{name} keeps the time of day")


def _running() -> set[str]:
    import psutil  # noqa: PLC0415

    return {str(each.info["name"]) for each in psutil.process_iter(["name"])}


def _windows() -> Finding:
    said = programs.output_of("sc", "query", _WINDOWS_SERVICE) or ""
    # Number and constant are the same in every language of Windows.
    if "4  RUNNING" in said:
        return ok("the Windows time service runs")
    return note(
        "the Windows time service does not run at the moment",
        _WHY,
        "Settings > Time & language > Date & time > Set time automatically, Sync now",
    )
