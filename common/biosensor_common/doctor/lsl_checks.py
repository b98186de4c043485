"""Checks the LSL configuration, and that all streams can be found, distinguished and aligned."""

from __future__ import annotations

import os
import re
import socket
import uuid
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from biosensor_common import liblsl
from biosensor_common.doctor.check import Context, Finding, Guide, error, note, ok, warning
from biosensor_common.doctor.firewall import opening
from biosensor_common.doctor.probe import Probe, SurveyedStream
from biosensor_common.errors import ConfigError
from biosensor_common.lsl import api_file
from biosensor_common.lsl.api_file import (
    DEFAULT_PORT_RANGE,
    LOOPBACK,
    LSL_BASE_PORT,
    LSL_PORT_RANGE,
    LSL_SESSION,
    PEERS,
    LslApiFile,
    check_session,
    config_places,
    home_folder,
    is_there,
)
from biosensor_common.lsl.sender_clocks import LIMIT_S

OWN_SEARCH_S = 4.0
_LIMIT_S = 12.0
# The IPv4 multicast groups of LSL's scope "site".
_GROUPS = "{255.255.255.255, 224.0.0.183, 239.255.172.215}"
# Addresses at which nobody answers, so that one way of discovery does not help the other.
_AWAY_PORT = "61440"
SEARCH_S, LISTEN_S = 3.0, LIMIT_S
"""liblsl measures a sender's clock again every 2 s, and the first answers may be late."""
_LISTENING_ENDS_S, _ENDS_S = 8.0, 18.0
MAX_STAMP_ERROR_S = 30.0
"""With a larger error, a stamp is not on the LSL clock at all (Unix time, device time)."""
MAX_ROUND_TRIP_S = 0.1
_SHOWN = 5
# pylsl generates it from Python's hash, which differs at every start.
_GENERATED_ID = re.compile(r"-?\d{15,20}")
_SAME_SESSION = "LSL programs see only streams in their own session."
_BY_AUTHOR = "ask the author of that program; in pylsl: StreamInfo(..., source_id='...')"


def lsl_config(context: Context) -> Iterator[Finding]:
    """Check the user's file, then the configuration that the program makes of it."""
    file = context.lsl_file
    yield from _places(file)
    own = LslApiFile("", "")
    if file is not None:
        try:
            text = file.read_bytes().decode("utf-8")
            own = LslApiFile(text, str(file))
            api_file.effective_config(file, context.overrides)
        except (OSError, UnicodeDecodeError, ConfigError) as problem:
            yield _damaged(file, problem)
            return
    if own.known_peers and not own.has_braces_around_peers:
        yield warning(
            "KnownPeers has no braces around its computers",
            f"Other LSL programs on this computer then ask none of them; {context.guide.program} "
            "does.",
            f"KnownPeers = {{{', '.join(own.known_peers)}}} below [lab] in {file}",
        )
    yield from _session(context, own)
    yield _in_force(context)
    yield from _peers(context)
    yield from _range(context, own)


def _places(used: Path | None) -> Iterator[Finding]:
    places = config_places(os.environ, home_folder(), Path.cwd())
    if used is None:
        yield ok("there is no lsl_api.cfg; LSL programs use their defaults")
    else:
        yield ok(f"LSL programs started here read {used}")
    named = os.environ.get("LSLAPICFG")
    if named and not is_there(Path(named)):
        yield warning(
            f"the environment variable LSLAPICFG names {named}, which does not exist",
            "LSL silently continues with the other locations.",
            "correct it where it is set, or remove it: the variable LSLAPICFG",
        )
    ignored = [place for place in places if is_there(place) and not _is_same(place, used)]
    if ignored:
        yield note(
            f"LSL does not read {', '.join(str(each) for each in ignored)}",
            f"Only the first file, {used}, is read.",
            f"put the settings into {used} and remove the others",
        )


def _is_same(place: Path, used: Path | None) -> bool:
    return used is not None and place.resolve() == used.resolve()


def _damaged(file: Path, problem: Exception) -> Finding:
    what = str(problem) if isinstance(problem, ConfigError) else f"{file}: {problem}"
    return error(
        what,
        "LSL silently ignores the whole file because of one line that it does not understand: "
        "session, peers and ports are then the defaults.",
        f"open {file} in a text editor, correct that line (comments start with ';', not with "
        "'#'), save it as UTF-8 and restart all LSL programs",
    )


def _session(context: Context, own: LslApiFile) -> Iterator[Finding]:
    chosen, guide = context.overrides.session_id, context.guide
    try:
        check_session(own.session_id, context.lsl_file)
    except ConfigError as problem:
        yield error(
            str(problem),
            "LSL programs started here find no streams, or also those of other sessions.",
            f"correct SessionID in {context.lsl_file} and restart all LSL programs",
        )
        return
    if chosen and chosen != own.session_id:
        yield warning(
            f"{guide.program} is in the LSL session {chosen}, LSL programs on this computer in "
            f"{own.session_id}",
            f"{_SAME_SESSION} Those here and {guide.program} do not see each other.",
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
                "Its streams are found only by multicast, if at all.",
                f"use its IP address instead of {peer}, or check that this works: ping {peer}",
            )


def _range(context: Context, own: LslApiFile) -> Iterator[Finding]:
    ports = own.ports
    count = ports.last - ports.first + 1
    # Without an entry, `LslApiFile` reports a single port, and liblsl uses its default.
    count = LSL_PORT_RANGE if count == 1 else count
    wanted = context.overrides.port_range or DEFAULT_PORT_RANGE
    if own.known_peers and count < wanted:
        yield note(
            f"PortRange is {count} for LSL programs on this computer, {wanted} for "
            f"{context.guide.program}",
            f"LabRecorder asks known peers on only {count} ports, which is {count // 2} streams.",
            context.guide.correct_file,
        )


def discovery(context: Context) -> Iterator[Finding]:
    """Offer a stream, and search for it by multicast and by unicast.

    Each way is tried with the other one disabled: LSL programs of one computer also find each
    other by unicast to their ports, so a stream that is found does not show that multicast works.
    """
    if liblsl.is_missing():
        yield _not_searched(context.guide)
        return
    config = context.config
    alone = api_file.keeps_to_itself(config)
    with ThreadPoolExecutor(2) as pool:
        multicast = None if alone else pool.submit(_is_found, config, by_multicast(config))
        unicast = pool.submit(_is_found, config, by_unicast(config))
        yield _unicast(unicast.result(), config)
        if multicast is None:
            yield note(
                "multicast was not tested: ResolveScope is machine in your lsl_api.cfg",
                "LSL looks for streams only on this computer, and is found only here.",
                "if other computers take part, remove ResolveScope from the file that the check "
                "lsl_config names",
            )
        else:
            yield _multicast(multicast.result(), config, context.guide)


def _not_searched(guide: Guide) -> Finding:
    return warning(
        "no stream was searched for, because liblsl cannot be loaded",
        "Whether LSL programs find each other on this computer is unknown.",
        liblsl.remedy(guide.install_pylsl),
    )


def by_multicast(config: str) -> str:
    """Return a configuration that finds streams by multicast only."""
    override = api_file.value(config, "multicast", "AddressesOverride")
    changed = {
        ("ports", "BasePort"): _AWAY_PORT,
        ("ports", "PortRange"): "1",
        ("lab", "KnownPeers"): "{}",
        ("multicast", "AddressesOverride"): override or _GROUPS,
    }
    return api_file.changed(config, changed)


def by_unicast(config: str, peer: str = LOOPBACK) -> str:
    """Return a configuration that finds streams of one computer by unicast only."""
    changed = {
        ("ports", "MulticastPort"): _AWAY_PORT,
        ("lab", "KnownPeers"): f"{{{peer}}}",
        ("multicast", "ResolveScope"): "machine",
        ("multicast", "AddressesOverride"): "{}",
    }
    return api_file.changed(config, changed)


def _is_found(offering: str, finding: str) -> bool:
    name = f"doctor-{uuid.uuid4().hex}"
    # In a separate session, so that nobody records it.
    session = {("lab", "SessionID"): name}
    with (
        Probe(
            "offer", _LIMIT_S, config=api_file.changed(offering, session), source_id=name
        ) as outlet,
        Probe(
            "find",
            _LIMIT_S,
            config=api_file.changed(finding, session),
            source_id=name,
            timeout_s=OWN_SEARCH_S,
        ) as finder,
    ):
        outlet.answer()
        return bool(finder.answer()["found"])


def _unicast(found: bool, config: str) -> Finding:
    if found:
        return ok("a stream of this computer is found here by unicast (KnownPeers)")
    return error(
        "a stream of this computer is not found here even when asked for directly",
        "Programs on this computer, including LabRecorder, see no streams: a firewall or another "
        "security program blocks them.",
        opening(api_file.ports(config)),
    )


def _multicast(found: bool, config: str, guide: Guide) -> Finding:
    if found:
        return ok("a stream of this computer is found here by multicast")
    return warning(
        "a stream of this computer is not found here by multicast",
        "LSL programs find streams by multicast unless they are told which computers to ask; "
        "LabRecorder then misses this computer's streams or all those of others.",
        f"{guide.ask_itself}\nfor other computers, {guide.ask_others.format(peer='ADDRESS')}\n"
        "or allow multicast: the check interfaces shows whether it has a route; if a "
        f"firewall is in the way:\n{opening(api_file.ports(config))}",
    )


def streams(context: Context) -> Iterator[Finding]:
    """Search for streams as the program does, and check them."""
    if liblsl.is_missing():
        yield _not_searched(context.guide)
        return
    seen, elsewhere = survey(context)
    if not seen:
        yield ok("there is no LSL stream at the moment")
    yield from judge(seen)
    yield from judge_elsewhere(elsewhere)
    yield from _unseen(context, seen)


def survey(context: Context) -> tuple[list[SurveyedStream], list[SurveyedStream]]:
    """Return the session's streams, and streams of other sessions with the same source_ids.

    This computer is also asked by unicast.
    """
    config = context.config
    names = dict.fromkeys((*api_file.known_peers(config), LOOPBACK))
    asking = api_file.changed(config, {PEERS: "{" + ", ".join(names) + "}"})
    with Probe(
        "survey",
        _ENDS_S,
        config=asking,
        search_s=SEARCH_S,
        listen_s=LISTEN_S,
        listen_until_s=_LISTENING_ENDS_S,
    ) as probe:
        found = probe.answer()
    ours, others = ([SurveyedStream(**e) for e in found[key]] for key in ("streams", "elsewhere"))
    return ours, others


def _unseen(context: Context, seen: Sequence[SurveyedStream]) -> Iterator[Finding]:
    """Report streams that the program offers and that were not found."""
    offered, guide = context.offered, context.guide
    missing = sorted(offered - {each.source_id for each in seen})
    if missing:
        yield error(
            f"{guide.program} offers {len(offered)} streams, and {len(missing)} of them are not "
            f"found here: {listed(missing)}",
            "LabRecorder and the node do not find them either.",
            "fix what the checks lsl_config, discovery and ports report",
        )


def judge(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    """Check the streams by all rules."""
    yield from _hosts(streams)
    for rule in (_names, _source_ids, _empty_ids, _generated_ids, _int64, _clocks, _far_ports):
        yield from rule(streams)


def listed(names: Iterable[str]) -> str:
    """Return the first names as text, and the number of further ones."""
    every = list(names)
    more = f" and {len(every) - _SHOWN} more" if len(every) > _SHOWN else ""
    return ", ".join(every[:_SHOWN]) + more


def _hosts(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    for host, there in _grouped(streams, lambda each: each.host).items():
        measured = [each for each in there if each.round_trip_s is not None]
        what = f"{_amount(there)} on {host}"
        best = min(measured, key=lambda each: each.round_trip_s or 0.0, default=None)
        if best is None or best.offset_s is None or best.round_trip_s is None:
            yield warning(
                f"{what}, which does not give its time",
                "Without its clock offset, its timestamps cannot be aligned with others. A "
                "firewall may allow TCP but not UDP.",
                f"on {host}: biosensor-gateway doctor; its firewall must allow incoming UDP and "
                f"TCP from {LSL_BASE_PORT}",
            )
            continue
        what += (
            f": clock offset {best.offset_s:+.6f} s, round trip {best.round_trip_s * 1e3:.2f} ms"
        )
        if best.round_trip_s <= MAX_ROUND_TRIP_S:
            yield ok(what)
            continue
        yield warning(
            what,
            "The offset may be wrong by half of the round trip. Such values come from busy or "
            "power-saving Wi-Fi.",
            f"connect {host} by cable, or see Tuning in "
            "https://labstreaminglayer.readthedocs.io/info/lslapicfg.html",
        )


def _names(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    for name, same in _repeated(streams, lambda each: each.name):
        yield warning(
            f"{len(same)} streams have the name {name} (on "
            f"{listed(sorted({e.host for e in same}))})",
            "LabRecorder lists streams by name and computer; those with the same name cannot be "
            "told apart.",
            "give each its own name; for devices of Biosensor Gateway, on its computer, set "
            "label or participant: biosensor-gateway config edit",
        )


def _source_ids(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    for source_id, same in _repeated(streams, lambda each: each.source_id):
        where = listed(sorted(f"{each.name} on {each.host}" for each in same))
        yield error(
            f"{len(same)} streams have the source_id {source_id}: {where}",
            "LabRecorder treats them as one, and receivers cannot continue after a restart.",
            "end all but one of the programs that send them; for two devices of Biosensor Gateway, "
            "on its computer, correct unit, label or participant: biosensor-gateway config edit",
        )


def judge_elsewhere(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    """Report streams of other sessions that have a source_id of this session."""
    for source_id, same in _grouped(streams, lambda each: each.source_id).items():
        where = listed(sorted(f"{e.name} on {e.host} in session {e.session!r}" for e in same))
        yield error(
            f"another LSL session also has the source_id {source_id}: {where}",
            "LabRecorder and other programs that lose this stream continue with that one, "
            "whatever its session: another person's data would follow in the same recording.",
            "end the program there, or correct unit, label or participant of its device",
        )


def _empty_ids(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    found = [each.name for each in streams if not each.source_id]
    if found:
        yield warning(
            f"without a source_id: {listed(found)}",
            "When that program restarts, its stream is missing from the rest of the recording.",
            f"let the program set a source_id that stays the same; {_BY_AUTHOR}",
        )


def _generated_ids(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    found = [each.name for each in streams if _GENERATED_ID.fullmatch(each.source_id)]
    if found:
        yield warning(
            f"with a source_id invented by pylsl: {listed(found)}",
            "It changes at every start of that program: a recording does not continue after a "
            "restart.",
            f"let the program set a source_id that stays the same; {_BY_AUTHOR}",
        )


def _int64(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    found = [each.name for each in streams if each.format == "int64"]
    if found:
        yield error(
            f"in the format int64: {listed(found)}",
            "LabRecorder writes no samples of such streams, and does not report it.",
            "let the program send int32 or double64",
        )


def _clocks(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    for each in streams:
        if each.stamp_error_s is not None and abs(each.stamp_error_s) > MAX_STAMP_ERROR_S:
            yield error(
                f"{each.name} on {each.host}: its timestamps are {each.stamp_error_s:+.0f} s off",
                "They are not on the LSL clock, so the stream cannot be aligned with others.",
                "let the program use timestamps from LSL's local_clock(), or none; Unix time and "
                "a device's own time are wrong",
            )


def _far_ports(streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    end = LSL_BASE_PORT + LSL_PORT_RANGE
    far = [each for each in streams if any(port >= end for port in each.ports)]
    for host, there in _grouped(far, lambda each: each.host).items():
        yield note(
            f"{_amount(there)} on {host}, on ports from {end}: "
            f"{listed(each.name for each in there)}",
            f"LSL programs without a configuration ask known peers on only {LSL_PORT_RANGE} "
            "ports, which is 16 streams. By multicast, they find all.",
            "on LabRecorder's computer: biosensor-gateway config lsl (with --for two-pc --peer "
            f"{host} if that is another computer)",
        )


def _repeated(
    streams: Sequence[SurveyedStream], key: Callable[[SurveyedStream], str]
) -> list[tuple[str, list[SurveyedStream]]]:
    groups = _grouped(streams, key)
    return [(name, same) for name, same in groups.items() if name and len(same) > 1]


def _grouped(
    streams: Sequence[SurveyedStream], key: Callable[[SurveyedStream], str]
) -> dict[str, list[SurveyedStream]]:
    groups: defaultdict[str, list[SurveyedStream]] = defaultdict(list)
    for each in streams:
        groups[key(each)].append(each)
    return groups


def _amount(streams: Sequence[SurveyedStream]) -> str:
    return "1 stream" if len(streams) == 1 else f"{len(streams)} streams"
