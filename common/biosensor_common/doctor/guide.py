"""The name of a program, and the remedies that its user is told."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Guide:
    """The words of one program; the remedies are exact commands or clicks.

    Attributes
    ----------
    program
        What a sentence calls it: ``"the agent"``.
    package, distribution
        Name by which it is imported, and by which it is installed.
    install
        How to install it.
    install_pylsl
        How to install pylsl.
    libraries
        Import names of what else it cannot run without, with the way to install each.
    ask_itself
        Have LSL programs of this computer ask this computer directly.
    ask_others
        Have LSL programs ask another computer directly; ``{peer}`` stands for an address
        of this one.
    correct_file
        Bring a ``lsl_api.cfg`` that is there already in line with the program.
    edit
        Change the settings of the program.
    alone
        Run one check, ``{check}``, and report it if it fails.
    """

    program: str
    package: str
    distribution: str
    install: str
    install_pylsl: str
    libraries: Mapping[str, str]
    ask_itself: str
    ask_others: str
    correct_file: str
    edit: str
    alone: str
