"""Checks the LSL configuration in use: its place, its content, its mistakes."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

from biosensor_common.doctor.check import Context, Finding, error, note, ok, warning
from biosensor_common.errors import ConfigError
from biosensor_common.lsl import api_file
from biosensor_common.lsl.api_file import (
    DEFAULT_PORT_RANGE,
    LSL_PORT_RANGE,
    LSL_SESSION,
    LslApiFile,
    config_places,
    is_there,
)

_SAME_SESSION = "LSL programs see only streams of their own session."


def lsl_config(context: Context) -> Iterator[Finding]:
    """Check the user's file, then the configuration that the program makes of it."""
    file = context.lsl_file
    yield from _places(file)
    own = LslApiFile("", "")
    if file is not None:
        try:
            text = file.read_bytes().decode("utf-8")
            own = LslApiFile(text, str(file))
        except (OSError, UnicodeDecodeError, ConfigError) as problem:
            yield _damaged(file, problem)
            return
    yield from _session(context, own)
    yield _in_force(context)
    yield from _peers(context)
    yield from _range(context, own)


def _places(used: Path | None) -> Iterator[Finding]:
    places = config_places(os.environ, Path.home(), Path.cwd())
    if used is None:
        yield ok("there is no lsl_api.cfg; LSL programs take their defaults")
    else:
        yield ok(f"LSL programs started here read {used}")
    named = os.environ.get("LSLAPICFG")
    if named and not is_there(Path(named)):
        yield warning(
            f"the environment variable LSLAPICFG names {named}, which is not there",
            "LSL goes on to the other places, silently.",
            "correct it where it is set, or remove it: the variable LSLAPICFG",
        )
    ignored = [place for place in places if is_there(place) and not _is_same(place, used)]
    if ignored:
        yield note(
            f"LSL does not read {', '.join(str(each) for each in ignored)}",
            f"Only the first file is read, which is {used}.",
            f"put the settings into {used} and remove the others",
        )


def _is_same(place: Path, used: Path | None) -> bool:
    return used is not None and place.resolve() == used.resolve()


def _damaged(file: Path, problem: Exception) -> Finding:
    what = str(problem) if isinstance(problem, ConfigError) else f"{file}: {problem}"
    return error(
        what,
        "LSL ignores the whole file for one line that it does not understand, and says nothing: "
        "session, peers and ports are then the defaults.",
        f"open {file} in a text editor, correct that line (comments begin with ';', not with "
        "'#'), save it as UTF-8 and restart all LSL programs",
    )


def _session(context: Context, own: LslApiFile) -> Iterator[Finding]:
    chosen, guide = context.overrides.session_id, context.guide
    if chosen and chosen != own.session_id:
        yield warning(
            f"{guide.program} is in the LSL session {chosen}, LSL programs of this computer in "
            f"{own.session_id}",
            f"{_SAME_SESSION} Those here and {guide.program} know nothing of each other.",
            f"{guide.correct_file}\nor remove session_id from the settings of {guide.program}: "
            f"{guide.edit}",
        )
    elif own.session_id != LSL_SESSION:
        yield note(
            f"the LSL session is {own.session_id}, not {LSL_SESSION}",
            f"{_SAME_SESSION} LabRecorder, agents and nodes on other computers need the same.",
            f"there: SessionID = {own.session_id} below [lab] in lsl_api.cfg, or session_id of "
            "the agent's settings and of the node's parameters",
        )


def _in_force(context: Context) -> Finding:
    config = context.config
    ports = api_file.ports(config)
    values = {
        "session": api_file.session(config),
        "known peers": api_file.value(config, "lab", "KnownPeers") or "none",
        "scope": api_file.value(config, "multicast", "ResolveScope") or "site",
        "ports": f"UDP {ports.discovery}, UDP and TCP {ports.first} to {ports.last}",
    }
    said = "; ".join(f"{name} {text}" for name, text in values.items())
    return ok(f"{context.guide.program}'s: {said}")


def _peers(context: Context) -> Iterator[Finding]:
    for peer in api_file.known_peers(context.config):
        try:
            socket.getaddrinfo(peer, None)
        except (OSError, UnicodeError):
            yield warning(
                f"the known peer {peer} has no address",
                "Its streams are found by multicast only, if at all.",
                f"use its IP address in place of {peer}, or make sure of: ping {peer}",
            )


def _range(context: Context, own: LslApiFile) -> Iterator[Finding]:
    ports = own.ports
    count = ports.last - ports.first + 1
    # Without an entry, `LslApiFile` reports a single port, and liblsl uses its default.
    count = LSL_PORT_RANGE if count == 1 else count
    wanted = context.overrides.port_range or DEFAULT_PORT_RANGE
    if own.known_peers and count < wanted:
        yield note(
            f"PortRange is {count} for LSL programs of this computer, {wanted} for "
            f"{context.guide.program}",
            f"LabRecorder asks known peers on {count} ports only, which is {count // 2} streams.",
            context.guide.correct_file,
        )
