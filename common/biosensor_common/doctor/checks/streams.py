"""Checks all streams in the network for what LabRecorder and the node cannot handle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from biosensor_common.doctor import lsl_text, stream_rules
from biosensor_common.doctor.children import Probe
from biosensor_common.doctor.context import Context
from biosensor_common.doctor.finding import Finding, error, ok
from biosensor_common.doctor.lsl_api_file import LOOPBACK
from biosensor_common.doctor.surveyed_stream import SurveyedStream
from biosensor_common.lsl.sender_clocks import LIMIT_S

SEARCH_S, LISTEN_S = 3.0, LIMIT_S
"""A sender's clock is asked for anew every 2 s, and the first answers may be late."""
_LISTENING_ENDS_S, _ENDS_S = 8.0, 18.0


def examine(context: Context) -> Iterator[Finding]:
    """Look for streams as the program does, and judge them."""
    streams, elsewhere = _survey(context)
    if not streams:
        yield ok("no LSL stream is there at the moment")
    yield from stream_rules.judge(streams)
    yield from stream_rules.judge_elsewhere(elsewhere)
    yield from _unseen(context, streams)


def find(context: Context) -> list[SurveyedStream]:
    """Return the streams of the program's session; this computer is asked directly, too."""
    return _survey(context)[0]


def _survey(context: Context) -> tuple[list[SurveyedStream], list[SurveyedStream]]:
    """Return the streams of the session, and those of others that have a source_id of these."""
    config = context.config
    peers = lsl_text.value(config, "lab", "KnownPeers").strip("{}")
    names = dict.fromkeys((*(each.strip() for each in peers.split(",") if each.strip()), LOOPBACK))
    asking = lsl_text.changed(config, {("lab", "KnownPeers"): "{" + ", ".join(names) + "}"})
    with Probe(
        "survey",
        _ENDS_S,
        config=asking,
        search_s=SEARCH_S,
        listen_s=LISTEN_S,
        listen_until_s=_LISTENING_ENDS_S,
    ) as probe:
        found = probe.answer()
    streams, elsewhere = (
        [SurveyedStream(**each) for each in found[key]] for key in ("streams", "elsewhere")
    )
    return streams, elsewhere


def _unseen(context: Context, streams: Sequence[SurveyedStream]) -> Iterator[Finding]:
    """Miss what the program says that it streams."""
    offered, guide = context.offered, context.guide
    missing = sorted(offered - {each.source_id for each in streams})
    if missing:
        yield error(
            f"{guide.program} offers {len(offered)} streams, and {len(missing)} of them are not "
            f"found here: {stream_rules.listed(missing)}",
            "LabRecorder and the node do not find them either.",
            "mend what the checks lsl_config, discovery and ports find",
        )
