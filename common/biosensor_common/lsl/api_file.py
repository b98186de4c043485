"""Reads and changes the text of an ``lsl_api.cfg``.

`LslApiFile` parses lines as liblsl's own reader does
(https://github.com/sccn/liblsl/blob/main/src/util/inireader.cpp), which ignores a whole
file for one line that it does not understand. The functions take what `effective_config`
has made, which is always understood.
"""

from __future__ import annotations

import configparser
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl_config import (
    LSL_BASE_PORT,
    LSL_DISCOVERY_PORT,
    LSL_SESSION,
    whole_number,
)

LOOPBACK = "127.0.0.1"
LSL_PORT_RANGE = 32
"""liblsl's default: enough for 16 streams."""

SESSION, PEERS = ("lab", "SessionID"), ("lab", "KnownPeers")
PORT_RANGE, BASE_PORT = ("ports", "PortRange"), ("ports", "BasePort")
DISCOVERY_PORT = ("ports", "MulticastPort")


class Ports(NamedTuple):
    """What firewalls must let in: UDP *discovery*, and UDP and TCP from *first* to *last*."""

    discovery: int
    first: int
    last: int


@dataclass(slots=True)
class Line:
    """A line with its line ending, and the setting in it, if any."""

    text: str
    section: str
    key: str = ""
    value: str = ""


class LslApiFile:
    """The text of a configuration, with its settings.

    Parameters
    ----------
    text
        The whole file.
    source
        Its name in error messages.

    Raises
    ------
    ConfigError
        ``MALFORMED``, if liblsl could not parse the file and would therefore ignore it.
    """

    def __init__(self, text: str, source: str) -> None:
        self._lines: list[Line] = list(_parsed(text, source))

    @property
    def session_id(self) -> str:
        """The session."""
        return self._get(SESSION) or LSL_SESSION

    @property
    def known_peers(self) -> tuple[str, ...]:
        """Hosts that liblsl asks directly."""
        names = self._get(PEERS).removeprefix("{").removesuffix("}").split(",")
        return tuple(name.strip() for name in names if name.strip())

    @property
    def ports(self) -> Ports:
        """The ports that firewalls must let in."""
        first = self._number(BASE_PORT, LSL_BASE_PORT)
        last = first + self._number(PORT_RANGE, 1) - 1
        return Ports(self._number(DISCOVERY_PORT, LSL_DISCOVERY_PORT), first, last)

    def _get(self, name: tuple[str, str]) -> str:
        return next((line.value for line in self._lines if (line.section, line.key) == name), "")

    def _number(self, name: tuple[str, str], default: int) -> int:
        return whole_number(self._get(name), default)


def _parsed(text: str, source: str) -> Iterator[Line]:
    section = ""
    seen: set[tuple[str, str]] = set()
    if text.startswith("\ufeff"):
        raise _malformed(source, 1, "a byte order mark; save it as UTF-8 without one")
    for number, line in enumerate(io.StringIO(text, newline="\n"), start=1):
        if not line.strip() or line.startswith(";"):
            yield Line(line, section)
        elif line.startswith("["):
            section, bracket, _ = line[1:].partition("]")
            if not bracket:
                raise _malformed(source, number, "the ']' of the section is missing")
            yield Line(line, section)
        else:
            key, equals, value = (part.strip() for part in line.partition("="))
            if not (key and equals and value):
                what = "it is no 'key = value', and no comment, which begins with ';'"
                raise _malformed(source, number, what)
            if (section, key) in seen:
                raise _malformed(source, number, f"{key} is set a second time")
            seen.add((section, key))
            yield Line(line, section, key, value)


def _malformed(source: str, number: int, what: str) -> ConfigError:
    message = (
        f"{source}, line {number}: {what}; LSL ignores the whole file for it; "
        "correct the line or remove the file"
    )
    return ConfigError(ConfigReason.MALFORMED, message)


def value(config: str, section: str, key: str) -> str:
    """Return a setting's value, empty if it is not set."""
    return _parser_of(config).get(section, key, fallback="").strip()


def changed(config: str, settings: Mapping[tuple[str, str], str]) -> str:
    """Return the configuration with these settings changed, by section and key."""
    parser = _parser_of(config)
    for (section, key), text in settings.items():
        if not parser.has_section(section):
            parser.add_section(section)
        parser.set(section, key, text)
    written = io.StringIO()
    parser.write(written)
    return written.getvalue()


def session(config: str) -> str:
    """Return the session of a configuration."""
    return value(config, *SESSION) or LSL_SESSION


def known_peers(config: str) -> list[str]:
    """Return the hosts that liblsl asks directly."""
    peers = value(config, *PEERS).strip("{}").split(",")
    return [peer.strip() for peer in peers if peer.strip()]


def keeps_to_itself(config: str) -> bool:
    """Whether LSL looks for streams on this computer only."""
    return value(config, "multicast", "ResolveScope") == "machine"


def ports(config: str) -> Ports:
    """Return the ports that LSL uses with a configuration."""
    first = _number_of(config, "BasePort", LSL_BASE_PORT)
    count = _number_of(config, "PortRange", LSL_PORT_RANGE)
    return Ports(
        _number_of(config, "MulticastPort", LSL_DISCOVERY_PORT),
        first,
        min(first + count - 1, 65535),
    )


def _number_of(config: str, key: str, default: int) -> int:
    return whole_number(value(config, "ports", key), default)


def _parser_of(config: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # liblsl's keys have case
    parser.read_string(config)
    return parser
