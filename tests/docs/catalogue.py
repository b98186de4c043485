"""The catalogue of sensors, made from their declarations and from what their pages say at the end.

A page ends with a comment, which no reader sees::

    <!-- catalogue
    title = "Acme Band"
    ...
    -->
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

from biosensor_common.quantities import ContentType
from biosensor_common.spec import FromDevice, StreamSpec
from biosensor_gateway.devices.registry import declaration, driver, sensor_names
from tests.docs.tables import table

PAGES = Path(__file__).parents[2] / "docs" / "sensors"
_FACTS = re.compile(r"<!-- catalogue\n(.*?)-->\n\Z", re.DOTALL)
_OPEN = "#open-until-hardware-was-seen"
_OF_THE_DEVICE = frozenset({ContentType.BATTERY, ContentType.RSSI})


@dataclass(frozen=True, slots=True)
class Facts:
    """What a sensor's page says for the catalogue; all are sentences or clauses."""

    title: str  # What people call the device.
    # way, systems: how it comes to the agent, and on which operating systems.
    way: str
    systems: str
    # vectors, peer, recording: what driver and virtual device were verified against.
    vectors: str
    peer: str
    recording: str
    traps: str  # What surprises those who use it.
    firmware: str  # The last one that the sources speak of; empty for none.


def facts(name: str) -> Facts:
    """Read the end of a sensor's page.

    Raises
    ------
    ValueError
        It has none, or not all of it.
    """
    found = _FACTS.search((PAGES / f"{name}.md").read_text(encoding="utf-8"))
    if found is None:
        raise ValueError(f"docs/sensors/{name}.md does not end with a catalogue")
    try:
        return Facts(**tomllib.loads(found[1]))
    except (TypeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"docs/sensors/{name}.md: its catalogue: {error}") from error


def pages() -> str:
    """Return a row for each page."""
    rows = [
        (f"[{facts(name).title}]({name}.md)", f"`{name}`", facts(name).way)
        for name in sensor_names()
    ]
    return f"\n{table(('Page', 'Name in the settings', 'Way to the agent'), rows)}\n\n"


def verified() -> str:
    """Return a row for each sensor: what it was verified against."""
    columns = ("Sensor", "Vectors", "Peer", "Recording", "Hardware", "Open")
    return f"\n{table(columns, [_verified(name) for name in sensor_names()])}\n\n"


def _verified(name: str) -> tuple[str, ...]:
    said = facts(name)
    link = f"[{said.title}]({name}.md)"
    return link, said.vectors, said.peer, said.recording, "not yet", f"[points]({name}.md{_OPEN})"


def catalogue() -> str:
    """Return a section for each sensor."""
    return "".join(f"\n{_section(name)}\n" for name in sensor_names()) + "\n"


def _section(name: str) -> str:
    said = facts(name)
    rows = [
        ("Streams", _streams(name)),
        ("Way to the agent", said.way),
        ("Systems", said.systems),
        ("Verified against", f"vectors: {said.vectors}; peer: {said.peer}; hardware: not yet"),
        ("To know", said.traps),
        *([("Last firmware in the sources", said.firmware)] if said.firmware else []),
    ]
    return f"## {said.title}\n\n{table((f'[`{name}`]({name}.md)', ''), rows)}"


def _streams(name: str) -> str:
    if driver(name).declare is not None:
        return "what its settings declare"
    streams = [
        each for each in declaration(name).streams if each.content_type not in _OF_THE_DEVICE
    ]
    return ", ".join(f"`{each.data_name}`{_rate(each)}" for each in streams)


def _rate(stream: StreamSpec) -> str:
    if isinstance(stream.rate, FromDevice):
        return " (rate by device)"
    return f" {stream.rate:.5g} Hz" if stream.is_regular else ""


def navigation() -> str:
    """Return the pages for the menu of the site."""
    return "".join(f'      - "{facts(name).title}": sensors/{name}.md\n' for name in sensor_names())
