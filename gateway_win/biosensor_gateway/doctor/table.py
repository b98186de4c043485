"""Which checks there are. A new one is a module of `checks` and a line here."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import StrEnum, unique
from importlib import import_module
from typing import NamedTuple, cast

from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.finding import Finding

Examine = Callable[[Context], Iterable[Finding]]


@unique
class Category(StrEnum):
    """What a check is about; findings are shown by it, in this order."""

    PROGRAM = "Program"
    LSL = "Lab Streaming Layer"
    NETWORK = "Network"
    DEVICES = "Devices and services"
    COMPUTER = "Computer"


class Check(NamedTuple):
    """One check.

    Attributes
    ----------
    name
        Name for ``--only``, and of its module.
    category
    title
        What it looks at, for the help.
    limit_s
        How long it may take.
    """

    name: str
    category: Category
    title: str
    limit_s: float = 10.0

    def load(self) -> Examine:
        """Import the check."""
        module = import_module(f"biosensor_gateway.doctor.checks.{self.name}")
        return cast("Examine", module.examine)


CHECKS = (
    Check("versions", Category.PROGRAM, "versions and places of the programs involved"),
    Check("settings", Category.PROGRAM, "settings file, state folder, running agent"),
    Check("lsl_config", Category.LSL, "the lsl_api.cfg in force and what it says"),
    Check("discovery", Category.LSL, "a stream of this computer is found here", limit_s=14.0),
    Check("streams", Category.LSL, "all streams in the network", limit_s=15.0),
    Check("interfaces", Category.NETWORK, "network adapters and the way of multicast"),
    Check("ports", Category.NETWORK, "the ports of LSL"),
    Check("linux_firewall", Category.NETWORK, "ufw and firewalld"),
    Check("windows_firewall", Category.NETWORK, "the firewall of Windows"),
    Check("host_name", Category.NETWORK, "the name of this computer"),
    Check("bluetooth", Category.DEVICES, "the Bluetooth adapter", limit_s=14.0),
    Check("serial", Category.DEVICES, "serial ports of the settings"),
    Check("services", Category.DEVICES, "vendors' services, their secrets, LabRecorder"),
    Check("power", Category.COMPUTER, "sleep, battery, power saving of Bluetooth"),
    Check("clock", Category.COMPUTER, "what keeps the clock right"),
)
"""In the order in which they are shown."""
