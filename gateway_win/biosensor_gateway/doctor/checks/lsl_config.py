"""The LSL configuration in force: where it comes from, what it says, what is wrong with it."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

from biosensor_common.errors import ConfigError
from biosensor_common.lsl_config import LSL_SESSION, config_places
from biosensor_gateway.doctor import lsl_text
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.finding import Finding, error, note, ok, warning
from biosensor_gateway.lsl_file import LslFile

_SAME_SESSION = "LSL programs see only streams of their own session."


def examine(context: Context) -> Iterator[Finding]:
    """Look at the user's file, then at what the agent makes of it."""
    file = context.lsl_file
    yield from _places(file)
    own = LslFile("", "")
    if file is not None:
        try:
            text = file.read_bytes().decode("utf-8")
            own = LslFile(text, str(file))
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
    if named and not Path(named).is_file():
        yield warning(
            f"the environment variable LSLAPICFG names {named}, which is not there",
            "LSL goes on to the other places, silently.",
            f"correct or remove the variable LSLAPICFG, or write the file: biosensor-gateway "
            f"config lsl --out {named}",
        )
    ignored = [place for place in places if place.is_file() and not _is_same(place, used)]
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


def _session(context: Context, own: LslFile) -> Iterator[Finding]:
    chosen = context.lsl.session_id
    if chosen and chosen != own.session_id:
        yield warning(
            f"the agent is in the LSL session {chosen}, LSL programs of this computer in "
            f"{own.session_id}",
            _SAME_SESSION + " LabRecorder here sees nothing of the agent.",
            "biosensor-gateway config lsl --force\nor remove session_id from the settings of the "
            "agent: biosensor-gateway config edit",
        )
    elif own.session_id != LSL_SESSION:
        yield note(
            f"the LSL session is {own.session_id}, not {LSL_SESSION}",
            _SAME_SESSION + " LabRecorder and the ROS node on other computers need the same.",
            f"there: SessionID = {own.session_id} below [lab] in lsl_api.cfg, and session_id of "
            "the ROS node",
        )


def _in_force(context: Context) -> Finding:
    config = context.agent_config
    ports = lsl_text.ports(config)
    values = {
        "session": lsl_text.value(config, "lab", "SessionID") or LSL_SESSION,
        "known peers": lsl_text.value(config, "lab", "KnownPeers") or "none",
        "scope": lsl_text.value(config, "multicast", "ResolveScope") or "site",
        "ports": f"UDP {ports.discovery}, UDP and TCP {ports.first} to {ports.last}",
    }
    return ok("the agent's: " + "; ".join(f"{name} {text}" for name, text in values.items()))


def _peers(context: Context) -> Iterator[Finding]:
    text = lsl_text.value(context.agent_config, "lab", "KnownPeers").strip("{}")
    for peer in (each.strip() for each in text.split(",") if each.strip()):
        try:
            socket.getaddrinfo(peer, None)
        except (OSError, UnicodeError):
            yield warning(
                f"the known peer {peer} has no address",
                "Its streams are found by multicast only, if at all.",
                f"use its IP address in place of {peer}, or make sure of: ping {peer}",
            )


def _range(context: Context, own: LslFile) -> Iterator[Finding]:
    ports = own.ports
    count = ports.last - ports.first + 1
    # Without an entry, what it says of itself is one port.
    count = lsl_text.LSL_PORT_RANGE if count == 1 else count
    if own.known_peers and count < context.lsl.port_range:
        yield note(
            f"PortRange is {count} for LSL programs of this computer, {context.lsl.port_range} "
            "for the agent",
            f"LabRecorder asks known peers on {count} ports only, which is {count // 2} streams.",
            "biosensor-gateway config lsl --force",
        )
