"""A check, and the category it belongs to."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from enum import StrEnum, unique
from importlib import import_module
from typing import Any, NamedTuple, cast

from biosensor_common.doctor.finding import Finding

Examine = Callable[[Any], Iterable[Finding]]
"""Takes the context of the program that it is a check of."""


@unique
class Category(StrEnum):
    """What a check is about; findings are shown by it, in this order."""

    PROGRAM = "Program"
    LSL = "Lab Streaming Layer"
    ROS = "ROS 2"
    NETWORK = "Network"
    DEVICES = "Devices and services"
    COMPUTER = "Computer"


class Check(NamedTuple):
    """One check.

    Attributes
    ----------
    name
        Name for ``--only``, and of its module.
    title
        What it looks at, for the help.
    package
        Where its module is.
    limit_s
        How long it may take.
    """

    name: str
    category: Category
    title: str
    package: str = "biosensor_common.doctor.checks"
    limit_s: float = 10.0

    def load(self) -> Examine:
        """Import the check."""
        module = import_module(f"{self.package}.{self.name}")
        return cast("Examine", module.examine)

    def mark(self, finding: Finding) -> Finding:
        """Return a finding as one of this check."""
        return replace(finding, check=self.name)


def by_category(*checks: Check) -> tuple[Check, ...]:
    """Return the checks in the order in which their findings are shown."""
    order = list(Category)
    return tuple(sorted(checks, key=lambda check: order.index(check.category)))
