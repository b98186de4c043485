"""Configures LSL for this process, and reads and changes the text of an ``lsl_api.cfg``.

liblsl reads exactly one configuration. Both programs pass theirs in memory before the first LSL
call, so they must merge in the user's settings: `effective_config`.

`LslApiFile` parses lines as liblsl's own reader does
(https://github.com/sccn/liblsl/blob/main/src/util/inireader.cpp), which ignores a whole
file for one line that it does not understand. The functions take what `effective_config`
has made, which is always understood.
"""

from __future__ import annotations

import configparser
import io
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import NamedTuple

from biosensor_common.errors import ConfigError, ConfigReason

CONFIG_NAME = "lsl_api.cfg"
# An outlet takes two ports, so liblsl's default of 32 hides every stream beyond the 16th.
DEFAULT_PORT_RANGE = 256
# liblsl's defaults.
LSL_BASE_PORT, LSL_DISCOVERY_PORT = 16572, 16571
LSL_SESSION = "default"
_MOST_DIGITS = 9
# liblsl writes to stderr, where our own log is: it shall write warnings and errors only.
_LOG_WARNINGS = -1
_SEARCH_PAUSES = ("MulticastMinRTT", "UnicastMinRTT")
_CHOICES = {
    ("ports", "IPv6"): ("allow", "disable", "force", "allowed", "disabled", "forced"),
    ("multicast", "ResolveScope"): ("machine", "link", "site", "organization", "global"),
}
_GROUPS = ("Machine", "Link", "Site", "Organization", "Global")
_ADDRESSES = {*(f"{group}Addresses" for group in _GROUPS), "AddressesOverride"}
# liblsl reads a number up to what is none, so that a comment may follow.
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))(?:\s*[;#].*)?")
_NUMBERS = {
    **{("ports", key): (0, 65535) for key in ("MulticastPort", "BasePort", "PortRange")},
    ("multicast", "TTLOverride"): (-1, 255),
    ("log", "level"): (-3, 9),
    **{
        ("tuning", key): (0, 10**9)
        for key in (
            *("UseProtocolVersion", "WatchdogCheckInterval", "WatchdogTimeThreshold"),
            *("MulticastMinRTT", "MulticastMaxRTT", "UnicastMinRTT", "UnicastMaxRTT"),
            *("ContinuousResolveInterval", "TimerResolution", "MaxCachedQueries"),
            *("TimeUpdateInterval", "TimeUpdateMinProbes", "TimeProbeCount", "TimeProbeInterval"),
            *("TimeProbeMaxRTT", "OutletBufferReserveMs", "OutletBufferReserveSamples"),
            *("InletBufferReserveMs", "InletBufferReserveSamples", "SmoothingHalftime"),
        )
    },
}
"""Of other words liblsl makes 0, of a decimal comma the whole number before it."""


@dataclass(frozen=True, slots=True)
class LslOverrides:
    """Values from our settings; an empty one leaves the user's own value.

    Attributes
    ----------
    session_id
        Programs see streams of their own session only; LabRecorder must use the same.
    known_peers
        Hosts to ask directly where multicast does not reach.
    port_range
        Number of ports from 16572 on; without it the user's own, but at least 256.
    search_pause_s
        Seconds that a search waits between asking by multicast and asking known peers, and
        before it asks again, unless the user's file sets it. liblsl's defaults are 0.5 and 0.75.
    """

    session_id: str = ""
    known_peers: tuple[str, ...] = ()
    port_range: int | None = None
    search_pause_s: float | None = None


def config_places(environment: Mapping[str, str], home: Path, folder: Path) -> tuple[Path, ...]:
    """Return the places where liblsl looks for its file; it reads the first that exists.

    Order of https://labstreaminglayer.readthedocs.io/info/lslapicfg.html: the
    variable ``LSLAPICFG``, the working folder, the home folder, the system.
    """
    named = environment.get("LSLAPICFG")
    return (
        *((Path(named),) if named else ()),
        folder / CONFIG_NAME,
        home_config_file(home),
        Path("/etc/lsl_api") / CONFIG_NAME,
    )


def home_config_file(home: Path) -> Path:
    """Return the path of the user's own file, in the home folder."""
    return home / "lsl_api" / CONFIG_NAME


def home_folder() -> Path:
    """Return the user's home folder.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if there is none, as for the user of many containers.
    """
    try:
        return Path.home()
    except RuntimeError as error:
        message = "this user has no home folder; set HOME to a folder that this user may write to"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error


def user_config_file(environment: Mapping[str, str], home: Path, folder: Path) -> Path | None:
    """Return the file that liblsl itself would read."""
    places = config_places(environment, home, folder)
    return next((path for path in places if is_there(path)), None)


def is_there(path: Path) -> bool:
    """Whether a file exists that this program may read."""
    try:
        return path.is_file()
    except OSError:
        # The folder is not readable; liblsl finds no file there, either.
        return False


def effective_config(user_file: Path | None, overrides: LslOverrides) -> str:
    """Return the text for ``pylsl.set_config_content``.

    Raises
    ------
    ConfigError
        ``UNREADABLE``, ``MALFORMED`` or ``WRONG_VALUE``, for the user's own file; ``WRONG_VALUE``
        for a session of ours that no LSL query can name.
    """
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # liblsl's keys have case
    if user_file is not None:
        _read(parser, user_file)
    _set(parser, "ports", "PortRange", str(overrides.port_range or _own_port_range(parser)))
    if overrides.session_id:
        _set(parser, *SESSION, overrides.session_id)
    check_session(parser.get(*SESSION, fallback=""), None if overrides.session_id else user_file)
    if overrides.known_peers:
        _set(parser, "lab", "KnownPeers", "{" + ", ".join(overrides.known_peers) + "}")
    if overrides.search_pause_s is not None:
        for key in _SEARCH_PAUSES:
            _set_default(parser, "tuning", key, str(overrides.search_pause_s))
    _set_default(parser, "log", "level", str(_LOG_WARNINGS))
    if user_file is not None:
        _require_usable(parser, user_file)
    text = io.StringIO()
    parser.write(text)
    return text.getvalue()


def config_here(overrides: LslOverrides) -> str:
    """Return `effective_config` for a program that is started here, with its errors."""
    return effective_config(user_config_file(os.environ, home_folder(), Path.cwd()), overrides)


def check_session(session: str, file: Path | None) -> None:
    """Check that liblsl can ask for a session, which it puts between apostrophes.

    With another apostrophe in it, programs find no stream, or those of all sessions.

    Parameters
    ----------
    file
        Where it stands; nothing for our own setting.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if it cannot.
    """
    if "'" in session:
        where = f"{file}: SessionID" if file else "session_id"
        message = (
            f"{where} is {session!r}, and LSL cannot look for a session with an apostrophe in its "
            "name; give it another name, the same in all programs"
        )
        raise ConfigError(ConfigReason.WRONG_VALUE, message)


def _require_usable(parser: configparser.ConfigParser, path: Path) -> None:
    """Refuse what makes liblsl drop the whole configuration, ours as well, or take another value.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, with the key and what it may be.
    """
    for section in parser.sections():
        for key, text in parser.items(section):
            wanted = _wanted_instead(section, key, text)
            if wanted:
                message = (
                    f"{path}: {key} = {text} in [{section}] should be {wanted}; LSL would use "
                    "other settings than yours; correct the line or remove it"
                )
                raise ConfigError(ConfigReason.WRONG_VALUE, message)


def _wanted_instead(section: str, key: str, text: str) -> str:
    """Return a phrase for what a wrong value should be; empty if the value is usable."""
    wanted = ""
    if key.startswith("["):
        wanted = "a section, with its ']'"
    elif (section, key) in _CHOICES:
        choices = _CHOICES[section, key]
        wanted = "" if text in choices else f"one of {', '.join(choices)}"
    elif (section, key) in _NUMBERS:
        least, most = _NUMBERS[section, key]
        number = _NUMBER.fullmatch(text)
        if number is None or not least <= float(number[1]) <= most:
            wanted = (
                f"a number {'such as 0.5' if section == 'tuning' else f'from {least} to {most}'}"
            )
    elif section == "multicast" and key in _ADDRESSES:
        if not (has_braces(text) and _are_addresses(text[1:-1])):
            wanted = "IP addresses in braces, such as {239.255.172.215}"
    elif (section, key) == ("multicast", "ListenAddress") and not _are_addresses(text):
        wanted = "an IP address"
    return wanted


def _are_addresses(text: str) -> bool:
    try:
        for each in filter(None, (part.strip() for part in text.split(","))):
            ip_address(each)
    except ValueError:
        return False
    return True


def has_braces(text: str) -> bool:
    """Whether a list is in braces; liblsl silently reads a list without them as empty."""
    return text.startswith("{") and text.endswith("}")


def _read(parser: configparser.ConfigParser, path: Path) -> None:
    try:
        # liblsl has no continuation lines; the parser would take indented lines for such.
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
        parser.read_string("\n".join(lines), source=str(path))
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: the LSL configuration cannot be read ({error}); fix or remove it"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    except configparser.Error as error:
        first_line = str(error).splitlines()[0]
        message = f"{path}: not an LSL configuration ({first_line}); fix or remove it"
        raise ConfigError(ConfigReason.MALFORMED, message) from error
    for section in parser.sections():
        for key, text in parser.items(section):
            if not text:
                # liblsl would drop the whole configuration for it.
                parser.remove_option(section, key)
    peers = parser.get(*PEERS, fallback="")
    if peers and not has_braces(peers):
        _set(parser, *PEERS, f"{{{_in_braces(peers)}}}")


def _in_braces(text: str) -> str:
    """Return a list without its braces, which may be missing, and what follows them."""
    return text.removeprefix("{").partition("}")[0]


def _own_port_range(parser: configparser.ConfigParser) -> int:
    return max(whole_number(parser.get("ports", "PortRange", fallback=""), 0), DEFAULT_PORT_RANGE)


def whole_number(text: str, default: int) -> int:
    """Parse a number before a comment, if any; the default if it is not a C integer."""
    number = _NUMBER.fullmatch(text)
    digits = number[1] if number else ""
    return int(digits) if digits.isdecimal() and len(digits) <= _MOST_DIGITS else default


def _set_default(parser: configparser.ConfigParser, section: str, key: str, value: str) -> None:
    if not parser.has_option(section, key):
        _set(parser, section, key, value)


def _set(parser: configparser.ConfigParser, section: str, key: str, value: str) -> None:
    if not parser.has_section(section):
        parser.add_section(section)
    parser.set(section, key, value)


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
        names = _in_braces(self._get(PEERS)).split(",")
        return tuple(name.strip() for name in names if name.strip())

    @property
    def has_braces_around_peers(self) -> bool:
        """Whether `known_peers` are in braces, without which liblsl ignores them."""
        return has_braces(self._get(PEERS))

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
                what = "it is neither 'key = value' nor a comment, which starts with ';'"
                raise _malformed(source, number, what)
            if (section, key) in seen:
                raise _malformed(source, number, f"{key} is set a second time")
            seen.add((section, key))
            yield Line(line, section, key, value)


def _malformed(source: str, number: int, what: str) -> ConfigError:
    message = (
        f"{source}, line {number}: {what}; LSL ignores the whole file because of it; correct the "
        "line or remove the file"
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
