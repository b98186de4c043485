"""Configures LSL for this process: the user's file, overlaid with our settings.

liblsl reads exactly one configuration. Both programs pass theirs in memory before
the first LSL call, so they must merge in the user's settings from ``lsl_api.cfg``.
"""

from __future__ import annotations

import configparser
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

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
        ``UNREADABLE`` or ``MALFORMED``, for the user's own file.
    """
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # liblsl's keys have case
    if user_file is not None:
        _read(parser, user_file)
    _set(parser, "ports", "PortRange", str(overrides.port_range or _own_port_range(parser)))
    if overrides.session_id:
        _set(parser, "lab", "SessionID", overrides.session_id)
    if overrides.known_peers:
        _set(parser, "lab", "KnownPeers", "{" + ", ".join(overrides.known_peers) + "}")
    if overrides.search_pause_s is not None:
        for key in _SEARCH_PAUSES:
            _set_default(parser, "tuning", key, str(overrides.search_pause_s))
    _set_default(parser, "log", "level", str(_LOG_WARNINGS))
    text = io.StringIO()
    parser.write(text)
    return text.getvalue()


def _read(parser: configparser.ConfigParser, path: Path) -> None:
    try:
        parser.read_string(path.read_text(encoding="utf-8"), source=str(path))
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: the LSL configuration cannot be read ({error}); fix or remove it"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    except configparser.Error as error:
        first_line = str(error).splitlines()[0]
        message = f"{path}: not an LSL configuration ({first_line}); fix or remove it"
        raise ConfigError(ConfigReason.MALFORMED, message) from error


def _own_port_range(parser: configparser.ConfigParser) -> int:
    return max(whole_number(parser.get("ports", "PortRange", fallback=""), 0), DEFAULT_PORT_RANGE)


def whole_number(text: str, default: int) -> int:
    """Parse a number of a configuration; the default if it is not a C integer."""
    return int(text) if text.isdecimal() and len(text) <= _MOST_DIGITS else default


def _set_default(parser: configparser.ConfigParser, section: str, key: str, value: str) -> None:
    if not parser.has_option(section, key):
        _set(parser, section, key, value)


def _set(parser: configparser.ConfigParser, section: str, key: str, value: str) -> None:
    if not parser.has_section(section):
        parser.add_section(section)
    parser.set(section, key, value)
