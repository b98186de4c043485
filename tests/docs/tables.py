"""Tables of findings, of known programs and of what virtual devices do, in Markdown."""

from __future__ import annotations

from biosensor_common import naming
from biosensor_common.known_senders import KNOWN, KnownStream
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.demo.virtual_devices import virtual_class, virtual_names
from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS
from biosensor_gateway.simulation.faults import OF_A_KIND, FaultKind, Kind, Untidiness
from tests.docs.sensor_table import table


def senders() -> str:
    """Return a row for each program: what its streams are called, and their topics."""
    programs = dict.fromkeys(stream.program for stream in KNOWN)
    rows = [(program, _names(program), _topics(program)) for program in programs]
    return f"\n{table(('Program', 'LSL streams', 'Topics behind `biosensors/`'), rows)}\n\n"


def _of(program: str) -> list[KnownStream]:
    return [stream for stream in KNOWN if stream.program == program]


def _names(program: str) -> str:
    return ", ".join(f"`{_readable(stream.name)}`" for stream in _of(program))


def _readable(pattern: str) -> str:
    readable = pattern.replace("(?P<unit>.+)", "<device>").replace("[- ]", "-")
    return readable.replace("_?[oO]", "O").replace("_?[sS]", "S")


def _topics(program: str) -> str:
    identities = [(DeviceIdentity(each.sensor, ""), each.data_name) for each in _of(program)]
    prefix = "biosensors/"
    return ", ".join(f"`{naming.topic(*each).removeprefix(prefix)}`" for each in identities)


def findings() -> str:
    """Return a section for each code."""
    parts = [
        f"### {each.title}\n\n`{code}`\n\n- **For a study:** {each.means}\n"
        f"- **To do:** {each.to_do}\n"
        for code, each in EXPLANATIONS.items()
    ]
    return "\n" + "\n".join(parts) + "\n"


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
