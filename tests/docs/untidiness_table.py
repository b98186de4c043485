"""The table of what virtual devices do that real ones do, and why some cannot."""

from __future__ import annotations

from biosensor_gateway.demo.virtual_devices import virtual_class, virtual_names
from biosensor_gateway.simulation.faults import OF_A_KIND, FaultKind, Kind, Untidiness
from tests.docs.sensor_table import table

KINDS: tuple[Kind, ...] = (*(each for each in FaultKind if each in OF_A_KIND), *Untidiness)


def untidiness() -> str:
    """Return a row for each virtual device, and below it the reasons by their numbers."""
    reasons: list[str] = []
    rows = [
        (f"`{name}`", *(_cell(name, kind, reasons) for kind in KINDS)) for name in virtual_names()
    ]
    head = ("", *(f"`{kind.value}`" for kind in KINDS))
    notes = "\n".join(f"{number}. {reason}" for number, reason in enumerate(reasons, 1))
    return f"\n{table(head, rows)}\n\n{notes}\n\n"


def _cell(name: str, kind: Kind, reasons: list[str]) -> str:
    found = virtual_class(name)
    if kind in found.effects:
        return "has"
    reason = found.impossible()[kind]
    if reason not in reasons:
        reasons.append(reason)
    return f"{reasons.index(reason) + 1}"
