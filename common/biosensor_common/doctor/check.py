"""Checks, their context and findings, and the list of all checks."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum, unique
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple, cast

from biosensor_common.errors import ConfigError
from biosensor_common.lsl.api_file import (
    LslOverrides,
    effective_config,
    home_folder,
    user_config_file,
)

AGENT, NODE = "agent", "node"

Examine = Callable[[Any], Iterable["Finding"]]
"""A check, which gets the context of the program that runs it."""


@unique
class Level(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    """Checked, and right."""
    NOTE = "note"
    """Good to know before a study."""
    WARNING = "warning"
    """It works, but it will fail in a case that the finding names."""
    ERROR = "error"
    """It does not work."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One result of a check: what was found, why it matters, and what to do.

    The fix is an exact command or click. The check's name is filled in when the check is run.

    Raises
    ------
    ValueError
        If a finding that is not OK has no reason or no fix.
    """

    level: Level
    what: str
    why: str = ""
    fix: str = ""
    check: str = ""

    def __post_init__(self) -> None:
        if self.level is not Level.OK and not (self.why and self.fix):
            raise ValueError(f"{self.what!r}: say why it matters and how to fix it")


def ok(what: str) -> Finding:
    """Return a finding that something is right."""
    return Finding(Level.OK, what)


def note(what: str, why: str, fix: str) -> Finding:
    """Return a finding that is useful to know but not a problem."""
    return Finding(Level.NOTE, what, why, fix)


def warning(what: str, why: str, fix: str) -> Finding:
    """Return a finding that something will fail in a named case."""
    return Finding(Level.WARNING, what, why, fix)


def error(what: str, why: str, fix: str) -> Finding:
    """Return a finding that something does not work."""
    return Finding(Level.ERROR, what, why, fix)


@dataclass(frozen=True, slots=True)
class Guide:
    """Texts of one program for its findings; the fixes are exact commands or clicks."""

    program: str  # Its name in a sentence: `"the agent"`.
    package: str
    distribution: str
    install: str
    install_pylsl: str
    libraries: Mapping[str, str]  # Import names of its required packages, with how to install each.
    # ask_itself, ask_others: how LSL programs of this computer, and of another one, are made to ask
    # this computer directly; `{peer}` is replaced by an address of this computer.
    ask_itself: str
    ask_others: str
    correct_file: str
    edit: str
    alone: str  # How to run only the check `{check}`, and to report it if it fails.


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """The program for which this computer is checked."""

    guide: Guide
    overrides: LslOverrides = field(default_factory=LslOverrides)
    """LSL settings of the program, which override the user's own configuration."""

    @property
    def lsl_file(self) -> Path | None:
        """The user's LSL configuration file that LSL programs started here would read."""
        return user_config_file(os.environ, home_folder(), Path.cwd())

    @property
    def config(self) -> str:
        """The program's LSL configuration; a damaged file of the user is left out."""
        try:
            return effective_config(self.lsl_file, self.overrides)
        except ConfigError:
            return effective_config(None, self.overrides)

    @property
    def streams_to_open(self) -> int:
        """How many streams the program will open on this computer."""
        return 0

    @property
    def offered(self) -> frozenset[str]:
        """The source_ids of the streams that the program reports as open here."""
        return frozenset()


@unique
class Category(StrEnum):
    """Subject of a check; findings are grouped by it, in this order."""

    PROGRAM = "Program"
    LSL = "Lab Streaming Layer"
    ROS = "ROS 2"
    NETWORK = "Network"
    DEVICES = "Devices and services"
    COMPUTER = "Computer"


class Check(NamedTuple):
    """One check: its name for ``--only``, and its help text."""

    name: str
    category: Category
    title: str
    module: str  # Module with a function of the check's name; it is imported when the check is run.
    limit_s: float = 10.0
    program: str = ""  # The only program that has the check; empty for all.

    def load(self) -> Examine:
        """Import the check's function."""
        return cast("Examine", getattr(import_module(self.module), self.name))

    def mark(self, finding: Finding) -> Finding:
        """Return a finding with this check's name."""
        return replace(finding, check=self.name)


_COMMON = "biosensor_common.doctor"
_COMPUTER, _NETWORK, _STREAMS = (
    f"{_COMMON}.{name}" for name in ("computer", "interfaces", "lsl_checks")
)
_FIREWALL = f"{_COMMON}.firewall"
_AGENTS = partial(Check, program=AGENT)
_AGENT = "biosensor_gateway.doctor"
_DEVICES = f"{_AGENT}.device_checks"
CHECKS = (
    Check(
        "versions", Category.PROGRAM, "versions and locations of the programs involved", _COMPUTER
    ),
    _AGENTS(
        "settings",
        Category.PROGRAM,
        "settings file, state folder, running agent",
        f"{_AGENT}.context",
    ),
    Check("lsl_config", Category.LSL, "the lsl_api.cfg in use and its contents", _STREAMS),
    Check("discovery", Category.LSL, "a stream of this computer is found here", _STREAMS, 14.0),
    Check("streams", Category.LSL, "all streams on the network", _STREAMS, 15.0),
    Check(
        "dds",
        Category.ROS,
        "ROS nodes find each other, and exactly one node lsl_to_ros runs",
        "lsl_to_ros.doctor.dds",
        15.0,
        NODE,
    ),
    Check("interfaces", Category.NETWORK, "network adapters and the route of multicast", _NETWORK),
    Check("ports", Category.NETWORK, "LSL's ports", _NETWORK),
    Check("linux_firewall", Category.NETWORK, "ufw and firewalld", _FIREWALL),
    Check("host_name", Category.NETWORK, "the name of this computer", _COMPUTER),
    _AGENTS(
        "windows_firewall",
        Category.NETWORK,
        "Windows' firewall",
        f"{_COMMON}.windows_firewall",
    ),
    _AGENTS("bluetooth", Category.DEVICES, "the Bluetooth adapter", _DEVICES, 14.0),
    _AGENTS("serial", Category.DEVICES, "serial ports in the settings", _DEVICES),
    _AGENTS(
        "services", Category.DEVICES, "vendors' services, their secrets, LabRecorder", _DEVICES
    ),
    _AGENTS("licences", Category.DEVICES, "licences of the vendors' services", _DEVICES, 14.0),
    Check(
        "open_files",
        Category.COMPUTER,
        "how many files, and so streams, a program may open",
        _COMPUTER,
    ),
    Check("clock", Category.COMPUTER, "clock synchronisation", _COMPUTER),
    _AGENTS("power", Category.COMPUTER, "sleep, battery, Bluetooth power saving", _DEVICES),
)
"""All checks, in the order in which they are shown."""


def checks_of(program: str) -> tuple[Check, ...]:
    """Return the checks of a program; the agent also has the node's, if the node is installed."""
    own = {"", program}
    if program == AGENT and all(map(find_spec, ("rclpy", "lsl_to_ros"))):
        own.add(NODE)
    return tuple(check for check in CHECKS if check.program in own)
