"""Checks the computer: programs and their versions, its name, its limits, its clock."""

from __future__ import annotations

import platform
import re
import socket
import sys
from collections.abc import Collection, Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

from biosensor_common import child, liblsl
from biosensor_common import process_limits as files
from biosensor_common.doctor.check import Context, Finding, Guide, error, note, ok, warning

_OLDEST_LIBLSL = 117
# Separates the parts of liblsl's build information; a branch name contains slashes itself.
_DETAIL = re.compile(r"/(?=\w+:)")
_PLAIN = re.compile(r"[A-Za-z0-9._-]+")
ENOUGH = 100
"""Streams of about a dozen devices."""
MAX_ERROR_S = 0.05
"""With a larger error, stamps of two computers cannot be compared."""
_NTP = ("chronyd", "ntpd", "ntpsec", "openntpd", "systemd-timesyncd")
_PTP, _TO_SYSTEM, _MASTER = "ptp4l", "phc2sys", "timemaster"
# The kernel cuts process names to 15 characters.
_KERNEL_NAME = 15
_WHY_TIME = (
    "Timestamps of ROS messages, logs and file dates of two computers drift apart. Streams "
    "within LSL are not affected: it measures clock offsets itself."
)
_WINDOWS_SERVICE = "w32time"


def versions(context: Context) -> Iterator[Finding]:
    """Report the versions of the programs and libraries."""
    guide = context.guide
    yield ok(f"{platform.platform()}, {platform.machine()}")
    yield _program(guide)
    yield ok(f"Python {platform.python_version()}, {sys.executable}")
    yield from _lsl(guide)
    for name, install in guide.libraries.items():
        yield _library(name, install, guide)


def _program(guide: Guide) -> Finding:
    # The folder of the package; that of a frozen program is next to its exe.
    place = Path(import_module(guide.package).__file__ or "").parent
    try:
        return ok(f"{guide.distribution} {version(guide.distribution)}, {place}")
    except PackageNotFoundError:
        return warning(
            f"{guide.distribution} is not installed; it runs from {place}",
            "Its version is unknown, and so are the versions of what it needs.",
            guide.install,
        )


def _lsl(guide: Guide) -> Iterator[Finding]:
    try:
        # Importing pylsl fails without liblsl.
        import pylsl
        from pylsl.lib import lib
    except (ImportError, OSError, RuntimeError) as problem:
        yield error(
            f"pylsl cannot be used: {_first_line(problem)}",
            "Without the Lab Streaming Layer's library (liblsl) there are no streams.",
            liblsl.remedy(guide.install_pylsl),
        )
        return
    yield ok(f"pylsl {version('pylsl')}, {Path(pylsl.__file__).parent}")
    number = pylsl.library_version()
    # One word of 120 letters would be wrapped at any place.
    details = _DETAIL.sub(", ", pylsl.library_info())
    what = f"liblsl {number // 100}.{number % 100} ({details}), {lib._name}"  # noqa: SLF001 - ctypes has no other name for it
    if number >= _OLDEST_LIBLSL and hasattr(lib, "lsl_set_config_content"):
        yield ok(what)
        return
    yield error(
        f"{what} is too old",
        "Its configuration is passed in a way that it supports since 1.17.7.",
        "remove the old library or the variable PYLSL_LIB that names it, then: "
        + guide.install_pylsl,
    )


def _library(name: str, install: str, guide: Guide) -> Finding:
    try:
        module = import_module(name)
    except Exception as problem:  # noqa: BLE001 - parts of the system may be missing
        return error(
            f"{name} cannot be used: {_first_line(problem)}",
            f"{guide.program.capitalize()} cannot start without it.",
            install,
        )
    return ok(f"{name} {_version(name)}, {Path(module.__file__ or '').parent}")


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "of an unknown version"


def _first_line(problem: BaseException) -> str:
    lines = str(problem).splitlines()
    return lines[0] if lines else type(problem).__name__


def host_name(_context: Context) -> Iterator[Finding]:
    """Check the host name for characters that some LSL programs cannot handle."""
    yield judge_name(socket.gethostname())


def judge_name(name: str) -> Finding:
    """Check a host name."""
    if _PLAIN.fullmatch(name):
        return ok(f"this computer's name is {name}")
    return warning(
        f"this computer's name is {name!r}",
        "LabRecorder cannot require streams of a computer with a space in its name, and letters "
        "outside ASCII stop some LSL programs.",
        "Settings > System > About > Rename this PC"
        if sys.platform == "win32"
        else "sudo hostnamectl set-hostname NAME, with letters, digits and '-' only",
    )


def open_files(context: Context) -> Iterator[Finding]:
    """Check the limit of open files; this program has raised its own already, as the others do."""
    yield judge_limit(files.limit(), context.streams_to_open)


def judge_limit(limit: int | None, streams: int) -> Finding:
    """Check whether the limit of open files (None: no limit) is enough for the streams to open."""
    if limit is None:
        return ok("the system does not limit how many files a program can open")
    sent, received = (files.fitting(limit, each) for each in (files.OUTLET, files.INLET))
    what = (
        f"a program may open {limit} files, which is enough to send {sent} streams or receive "
        f"{received}"
    )
    if streams > sent:
        why = "Devices whose streams do not fit are left out."
        return error(f"{what}; the settings have {streams} streams", why, files.fix())
    if sent < ENOUGH:
        why = "Streams that do not fit are left out by the agent and the node."
        return note(what, why, files.fix())
    return ok(what)


class Tracking(NamedTuple):
    """Status of chrony."""

    source: str
    """Its time source; empty if none."""
    offset_s: float
    """Estimated error of the clock."""
    bound_s: float
    """Largest possible error of the clock: offset, root dispersion and half the root delay."""


def clock(_context: Context) -> Iterator[Finding]:
    """Check what synchronises the system clock: NTP (chrony and others) or PTP (linuxptp).

    LSL's clock does not depend on it; file dates, the log and ROS stamps do.
    """
    if sys.platform == "linux":
        said = child.output_of("timedatectl", "show", "-p", "NTP", "-p", "NTPSynchronized")
        tracked = child.output_of("chronyc", "-n", "-c", "tracking")
        yield from judge_clock(_running_programs(), said or "", tracking(tracked or ""))
    elif sys.platform == "win32":
        yield _windows()


def judge_clock(
    running: Collection[str], timedatectl: str, chrony: Tracking | None = None
) -> Iterator[Finding]:
    """Check the running time services and the output of timedatectl and chrony."""
    there = [each for each in (*_NTP, _PTP, _TO_SYSTEM) if each[:_KERNEL_NAME] in running]
    ntp = [each for each in there if each in _NTP]
    lines = [line.partition("=") for line in timedatectl.splitlines()]
    shown = {key: value for key, _, value in lines}
    if not there and shown.get("NTP") != "yes":
        yield note(
            "nothing synchronises this computer's clock",
            _WHY_TIME,
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
        yield ok(f"{', '.join(there) or 'a time service'} synchronises the clock")


def tracking(said: str) -> Tracking | None:
    """Parse the output of ``chronyc -c tracking``; None if it is something else."""
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
        # The one named last is the more exact one.
        yield warning(
            f"{' and '.join(setting)} set the clock at the same time",
            "Each undoes what the other does: the clock jumps, and so do ROS timestamps.",
            f"keep only one of them, for instance: sudo systemctl disable --now {setting[0]}\n"
            "for PTP and NTP together: timemaster, or chrony with the adapter as its refclock "
            "PHC",
        )


def _chrony(said: Tracking) -> Finding:
    if not said.source:
        return _not_synchronised("chronyd")
    what = (
        f"chronyd follows {said.source}: the clock is off by an estimated "
        f"{said.offset_s * 1e3:+.3f} ms, at most {said.bound_s * 1e3:.3f} ms"
    )
    if said.bound_s <= MAX_ERROR_S:
        return ok(what)
    return note(
        what,
        "Timestamps of ROS messages of two computers can differ by that much. " + _WHY_TIME,
        "let the lab's computers follow one server in the lab: server ADDRESS iburst in "
        "/etc/chrony/chrony.conf, then: sudo systemctl restart chrony",
    )


def _adapter_only() -> Finding:
    return note(
        "ptp4l runs, but phc2sys does not, and the time of day is not synchronised",
        "With timestamps of the hardware, ptp4l sets the clock of the network adapter only. "
        + _WHY_TIME,
        "sudo phc2sys -a -r (as a service: sudo systemctl enable --now phc2sys@eth0)",
    )


def _not_synchronised(name: str) -> Finding:
    return note(
        f"{name} runs, but the time of day is not synchronised",
        _WHY_TIME,
        "connect this computer to its time server, then: timedatectl timesync-status, or "
        "chronyc tracking",
    )


def _running_programs() -> set[str]:
    import psutil

    return {str(each.info["name"]) for each in psutil.process_iter(["name"])}


def _windows() -> Finding:
    said = child.output_of("sc", "query", _WINDOWS_SERVICE) or ""
    # Words of the output are translated; its numbers and constants are the same in every language.
    if "4  RUNNING" in said:
        return ok("the Windows time service runs")
    return note(
        "the Windows time service does not run at the moment",
        _WHY_TIME,
        "Settings > Time & language > Date & time > Set time automatically, Sync now",
    )
