"""The user's ``lsl_api.cfg``: what the agent makes of it, and what the doctor reads in it.

It is read, or refused with a ConfigError; what is made of it can be read again and says
what was asked for; a file that is adapted once needs nothing more.
"""

from __future__ import annotations

from biosensor_common.errors import ConfigError
from biosensor_common.lsl import api_file
from biosensor_common.lsl.api_file import LslOverrides, effective_config
from biosensor_gateway.cli.config import LslFile, Ports, changes
from tests.fuzz.contract import ensure
from tests.fuzz.scratch import written

_PEERS = ("10.0.0.7", "lab-pc.local")
_SESSION = "study7"
_WANTED = (_SESSION, _PEERS, 300)


def check(data: bytes) -> None:
    """Read the file in both ways."""
    for overrides in (LslOverrides(), LslOverrides("study7", _PEERS, 300)):
        _overlay(data, overrides)
    _adapt(data.decode("utf-8", "surrogateescape"))


def _overlay(data: bytes, overrides: LslOverrides) -> None:
    try:
        config = effective_config(written("lsl_api.cfg", data), overrides)
    except ConfigError:
        return
    _are_ports(api_file.ports(config))
    session = api_file.value(config, "lab", "SessionID")
    ensure(session == overrides.session_id or not overrides.session_id, "another session", config)
    peers = api_file.value(config, "lab", "KnownPeers")
    ensure(all(peer in peers for peer in overrides.known_peers), "peers are missing", config)
    moved = api_file.changed(config, {("ports", "BasePort"): "20000"})
    ensure(api_file.value(moved, "ports", "BasePort") == "20000", "it did not change", moved)


def _adapt(text: str) -> None:
    try:
        file = LslFile(text, "lsl_api.cfg")
    except ConfigError:
        return
    _are_ports(file.ports)
    peers = file.known_peers
    file.adapt(*_WANTED)
    again = LslFile(file.text, "lsl_api.cfg")
    ensure(again.session_id == _SESSION, "another session", file.text)
    ensure(set(peers) | set(_PEERS) <= set(again.known_peers), "peers are missing", file.text)
    again.adapt(*_WANTED)
    ensure(again.text == file.text, "once was not enough", file.text, again.text)
    for line in changes(text, file.text):
        line.encode()


def _are_ports(ports: Ports) -> None:
    ensure(ports.discovery >= 0 and ports.first >= 0, "no ports", ports)
