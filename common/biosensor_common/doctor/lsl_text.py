"""Reads and changes an LSL configuration as text."""

from __future__ import annotations

import configparser
import io
from collections.abc import Mapping

from biosensor_common.doctor.lsl_api_file import Ports
from biosensor_common.lsl_config import LSL_BASE_PORT, LSL_DISCOVERY_PORT, whole_number

LSL_PORT_RANGE = 32
"""What liblsl takes where nothing else is said: 16 streams."""


def value(config: str, section: str, key: str) -> str:
    """Return a setting, empty if it is not there."""
    return _parsed(config).get(section, key, fallback="").strip()


def changed(config: str, settings: Mapping[tuple[str, str], str]) -> str:
    """Return the configuration with these settings, by section and key."""
    parser = _parsed(config)
    for (section, key), text in settings.items():
        if not parser.has_section(section):
            parser.add_section(section)
        parser.set(section, key, text)
    written = io.StringIO()
    parser.write(written)
    return written.getvalue()


def ports(config: str) -> Ports:
    """Return the ports that LSL uses with a configuration."""
    first = _number(config, "BasePort", LSL_BASE_PORT)
    count = _number(config, "PortRange", LSL_PORT_RANGE)
    return Ports(
        _number(config, "MulticastPort", LSL_DISCOVERY_PORT), first, min(first + count - 1, 65535)
    )


def _number(config: str, key: str, default: int) -> int:
    return whole_number(value(config, "ports", key), default)


def _parsed(config: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # liblsl's keys have case
    parser.read_string(config)
    return parser
