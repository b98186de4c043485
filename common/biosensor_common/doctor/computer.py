"""Checks what keeps the time of day right: NTP (chrony and others) or PTP (linuxptp).

LSL's own clock does not depend on it; file dates, the log and the stamps of ROS do.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from typing import NamedTuple

from biosensor_common.doctor import programs
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, note, ok, warning

MAX_ERROR_S = 0.05
"""A clock that may be further off than this is no clock for stamps of two computers."""
_NTP = ("chronyd", "ntpd", "ntpsec", "openntpd", "systemd-timesyncd")
_PTP, _TO_SYSTEM, _MASTER = "ptp4l", "phc2sys", "timemaster"
# The kernel keeps 15 characters of a name.
_KERNEL_NAME = 15
_WHY = (
    "Stamps of ROS messages, logs and file dates of two computers drift apart. Streams within LSL "
    "are not affected: it measures clock offsets itself."
)
_WINDOWS_SERVICE = "w32time"


class Tracking(NamedTuple):
    """What chrony says of itself.

    Attributes
    ----------
    source
        What it follows; empty for nothing.
    offset_s
        How far the clock is off, by its estimate.
    bound_s
        How far it can be off at most: offset, root dispersion and half the root delay.
    """

    source: str
    offset_s: float
    bound_s: float


def examine(_context: Context) -> Iterator[Finding]:
    """Ask the system."""
    if sys.platform == "linux":
        said = programs.output_of("timedatectl", "show", "-p", "NTP", "-p", "NTPSynchronized")
        tracked = programs.output_of("chronyc", "-n", "-c", "tracking")
        yield from judge(_running(), said or "", tracking(tracked or ""))
    elif sys.platform == "win32":
        yield _windows()


def judge(
    running: Collection[str], timedatectl: str, chrony: Tracking | None = None
) -> Iterator[Finding]:
    """Judge the programs that run, what timedatectl shows and what chrony says."""
    there = [each for each in (*_NTP, _PTP, _TO_SYSTEM) if each[:_KERNEL_NAME] in running]
    ntp = [each for each in there if each in _NTP]
    lines = [line.partition("=") for line in timedatectl.splitlines()]
    shown = {key: value for key, _, value in lines}
    if not there and shown.get("NTP") != "yes":
        yield note(
            "nothing keeps this computer's time of day right",
            _WHY,
            "sudo timedatectl set-ntp true\nor install chrony: sudo apt install chrony",
        )
        return
    if _MASTER not in running:
        yield from _quarrel([each for each in there if each != _PTP])
    if chrony is not None and "chronyd" in ntp:
        yield _chrony(chrony)
    elif there == [_PTP] and shown.get("NTPSynchronized") != "yes":
        yield _adapter_only()
    elif _TO_SYSTEM not in there and shown.get("NTPSynchronized") == "no":
        yield _not_synchronised(", ".join(there) or "a time service")
    else:
        yield ok(f"{', '.join(there) or 'a time service'} keeps the time of day")


def tracking(said: str) -> Tracking | None:
    """Read what ``chronyc -c tracking`` says; None if it is something else."""
    fields = said.strip().split(",")
    try:
        reference, name, *_, leap = fields
        offset_s, delay_s, dispersion_s = (float(fields[at]) for at in (4, 10, 11))
    except (ValueError, IndexError):
        return None
    source = "" if leap == "Not synchronised" else name or reference
    return Tracking(source, offset_s, abs(offset_s) + dispersion_s + delay_s / 2)


def _quarrel(setting: list[str]) -> Iterator[Finding]:
    if len(setting) > 1:
        # What is named last is the more exact one.
        yield warning(
            f"{' and '.join(setting)} set the clock at the same time",
            "Each undoes what the other does: the time of day jumps, and stamps of ROS with it.",
            f"keep one of them, for instance: sudo systemctl disable --now {setting[0]}\n"
            "for PTP and NTP together: timemaster, or chrony with the adapter as its refclock PHC",
        )


def _chrony(said: Tracking) -> Finding:
    if not said.source:
        return _not_synchronised("chronyd")
    what = (
        f"chronyd follows {said.source}: the clock is {said.offset_s * 1e3:+.3f} ms off by its "
        f"estimate, {said.bound_s * 1e3:.3f} ms at most"
    )
    if said.bound_s <= MAX_ERROR_S:
        return ok(what)
    return note(
        what,
        "Stamps of ROS messages of two computers can differ by that much. " + _WHY,
        "have the computers of the lab follow one server in the lab: server ADDRESS iburst in "
        "/etc/chrony/chrony.conf, then: sudo systemctl restart chrony",
    )


def _adapter_only() -> Finding:
    return note(
        "ptp4l runs, but phc2sys does not, and the time of day is not synchronised",
        "With time stamps of the hardware, ptp4l sets the clock of the network adapter only. "
        + _WHY,
        "sudo phc2sys -a -r (as a service: sudo systemctl enable --now phc2sys@eth0)",
    )


def _not_synchronised(name: str) -> Finding:
    return note(
        f"{name} runs, but the time of day is not synchronised",
        _WHY,
        "connect this computer to its time server, then: timedatectl timesync-status, or "
        "chronyc tracking",
    )


def _running() -> set[str]:
    import psutil

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
