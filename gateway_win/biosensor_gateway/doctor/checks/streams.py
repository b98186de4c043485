"""All streams in the network: what LabRecorder and the node will trip over."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from biosensor_common.errors import ConfigError
from biosensor_gateway.doctor import lsl_text, stream_rules
from biosensor_gateway.doctor.children import Probe
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.finding import Finding, error, ok
from biosensor_gateway.doctor.seen_stream import SeenStream
from biosensor_gateway.lsl_file import LOOPBACK

SEARCH_S, LISTEN_S = 3.0, 2.0
_LISTENING_ENDS_S, _LIMIT_S = 8.0, 14.0


def examine(context: Context) -> Iterator[Finding]:
    """Look for streams as the agent's computer does, and judge them."""
    streams = find(context)
    if not streams:
        yield ok("no LSL stream is there at the moment")
    yield from stream_rules.judge(streams)
    yield from _unseen(context, streams)


def find(context: Context) -> list[SeenStream]:
    """Return the streams of the agent's session; this computer is asked directly, too."""
    config = context.agent_config
    peers = lsl_text.value(config, "lab", "KnownPeers").strip("{}")
    names = dict.fromkeys((*(each.strip() for each in peers.split(",") if each.strip()), LOOPBACK))
    asking = lsl_text.changed(config, {("lab", "KnownPeers"): "{" + ", ".join(names) + "}"})
    with Probe(
        "survey",
        _LIMIT_S,
        config=asking,
        search_s=SEARCH_S,
        listen_s=LISTEN_S,
        listen_until_s=_LISTENING_ENDS_S,
    ) as probe:
        return [SeenStream(**each) for each in probe.answer()["streams"]]


def _unseen(context: Context, streams: Sequence[SeenStream]) -> Iterator[Finding]:
    """Miss what the running agent says that it streams."""
    from biosensor_gateway import health  # noqa: PLC0415 - brings pylsl

    try:
        status = health.read_status(context.state_folder)
    except ConfigError:
        return
    offered = {source for device in status["devices"] for source in device["streams"]}
    missing = sorted(offered - {each.source_id for each in streams})
    if missing:
        yield error(
            f"the agent offers {len(offered)} streams, and {len(missing)} of them are not found "
            f"here: {stream_rules.listed(missing)}",
            "LabRecorder and the node do not find them either.",
            "see the other findings: biosensor-gateway doctor --only lsl_config --only discovery "
            "--only ports",
        )
