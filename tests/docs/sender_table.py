"""The table of other programs whose streams are known, in Markdown."""

from __future__ import annotations

from biosensor_common import naming
from biosensor_common.known_senders import KNOWN, KnownStream
from biosensor_common.spec import DeviceIdentity
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
