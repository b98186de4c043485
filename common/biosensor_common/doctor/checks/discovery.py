"""Checks that a stream of this computer is found here, by multicast and by unicast.

Both ways are tried apart from each other: LSL programs of the same computer also find
each other by a question to their ports, so that a stream that is found says nothing of
multicast unless that is made impossible.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from biosensor_common.doctor import lsl_text
from biosensor_common.doctor.children import Probe
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, error, note, ok, warning
from biosensor_common.doctor.firewall_rules import opening
from biosensor_common.doctor.guide import Guide
from biosensor_common.doctor.lsl_api_file import LOOPBACK

SEARCH_S = 4.0
_LIMIT_S = 12.0
# The groups of LSL's scope "site" that IPv4 has.
_GROUPS = "{255.255.255.255, 224.0.0.183, 239.255.172.215}"
# Where nobody is asked, so that one way does not help the other.
_AWAY_PORT = "61440"


def examine(context: Context) -> Iterator[Finding]:
    """Offer a stream, and look for it."""
    config = context.config
    alone = lsl_text.value(config, "multicast", "ResolveScope") == "machine"
    with ThreadPoolExecutor(2) as pool:
        multicast = None if alone else pool.submit(_is_found, config, by_multicast(config))
        unicast = pool.submit(_is_found, config, by_unicast(config))
        yield _unicast(unicast.result(), config)
        if multicast is None:
            yield note(
                "multicast was not tried: ResolveScope is machine in your lsl_api.cfg",
                "LSL looks for streams on this computer only, and is found by it only.",
                "if other computers take part, remove ResolveScope from the file that the check "
                "lsl_config names",
            )
        else:
            yield _multicast(multicast.result(), config, context.guide)


def by_multicast(config: str) -> str:
    """Return a configuration that finds streams by multicast only."""
    override = lsl_text.value(config, "multicast", "AddressesOverride")
    changed = {
        ("ports", "BasePort"): _AWAY_PORT,
        ("ports", "PortRange"): "1",
        ("lab", "KnownPeers"): "{}",
        ("multicast", "AddressesOverride"): override or _GROUPS,
    }
    return lsl_text.changed(config, changed)


def by_unicast(config: str, peer: str = LOOPBACK) -> str:
    """Return a configuration that finds streams of one computer by unicast only."""
    changed = {
        ("ports", "MulticastPort"): _AWAY_PORT,
        ("lab", "KnownPeers"): f"{{{peer}}}",
        ("multicast", "ResolveScope"): "machine",
        ("multicast", "AddressesOverride"): "{}",
    }
    return lsl_text.changed(config, changed)


def _is_found(offering: str, finding: str) -> bool:
    name = f"doctor-{uuid.uuid4().hex}"
    # In a session of its own, nobody records it.
    session = {("lab", "SessionID"): name}
    with (
        Probe(
            "offer", _LIMIT_S, config=lsl_text.changed(offering, session), source_id=name
        ) as outlet,
        Probe(
            "find",
            _LIMIT_S,
            config=lsl_text.changed(finding, session),
            source_id=name,
            timeout_s=SEARCH_S,
        ) as finder,
    ):
        outlet.answer()
        return bool(finder.answer()["found"])


def _unicast(found: bool, config: str) -> Finding:
    if found:
        return ok("a stream of this computer is found here by unicast (KnownPeers)")
    return error(
        "a stream of this computer is not even found here when it is asked for directly",
        "Programs of this computer, LabRecorder too, see no streams: a firewall or another "
        "security program stands between them.",
        opening(lsl_text.ports(config)),
    )


def _multicast(found: bool, config: str, guide: Guide) -> Finding:
    if found:
        return ok("a stream of this computer is found here by multicast")
    return warning(
        "a stream of this computer is not found here by multicast",
        "LSL programs find streams by multicast unless they are told which computers to ask; "
        "LabRecorder then misses streams of this computer or all those of others.",
        f"{guide.ask_itself}\nfor other computers, {guide.ask_others.format(peer='ADDRESS')}\n"
        "or let multicast through: the check interfaces says whether there is a way for it; if a "
        f"firewall is in the way:\n{opening(lsl_text.ports(config))}",
    )
