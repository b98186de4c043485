"""Names of topics, of streams that anybody may have named: four fields a stream.

All names are valid in ROS; different devices never share one; the order in which
streams are seen changes nothing.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations, pairwise

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from tests.fuzz.contract import ensure

Stream = tuple[DeviceIdentity, str]

_TOKEN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LSL_NAME = re.compile(r"[A-Za-z0-9_-]+")
_LONGEST_TOKEN = 64
_MOST_STREAMS = 8


def check(data: bytes) -> None:
    """Take the fields, which end with a line, as foreign streams and as our own."""
    fields = data.decode("utf-8", "surrogateescape").split("\n")[: 4 * _MOST_STREAMS]
    for text in fields:
        _is_token(naming.sanitise(text))
    for one, other in pairwise(fields):
        ensure(one == other or naming.sanitise(one) != naming.sanitise(other), "one token", one)
    quads = [fields[at : at + 4] for at in range(0, 4 * _MOST_STREAMS, 4)]
    full = [quad for quad in quads if len(quad) == 4]
    foreign = [naming.foreign_identity(*quad) for quad in full]
    own = [
        (DeviceIdentity(sensor, unit, participant, label), "hr")
        for sensor, unit, participant, label in full
    ]
    for streams in (foreign, own, foreign + own):
        _resolve(streams)
    _are_distinct(own)


def _resolve(streams: Sequence[Stream]) -> None:
    topics = naming.resolve_topics(dict(enumerate(streams)))
    owners: dict[str, Stream] = {}
    for key, stream in enumerate(streams):
        topic = topics[key]
        for part in topic.name.split("/"):
            _is_token(part)
        ensure(len(topic.name.split("/")) in (3, 4), "no topic", topic)
        owner = owners.setdefault(topic.name, stream)
        ensure(owner == stream, "two streams share a topic", owner, stream, topic)
    backwards = naming.resolve_topics(dict(reversed(list(enumerate(streams)))))
    ensure(backwards == topics, "the order decides", streams)


def _are_distinct(streams: Sequence[Stream]) -> None:
    for one, other in combinations(set(streams), 2):
        names = naming.lsl_name(*one), naming.lsl_name(*other)
        ensure(names[0] != names[1], "two streams have one LSL name", one, other)
    for stream in streams:
        name = naming.lsl_name(*stream)
        ensure(_LSL_NAME.fullmatch(name) is not None, "no LSL name", name)
        source_id = naming.source_id(*stream)
        ensure(not set(source_id) & set("'\" \t\r\n"), "no source_id", source_id)


def _is_token(token: str) -> None:
    is_valid = _TOKEN.fullmatch(token) is not None and "__" not in token
    ensure(is_valid and len(token) <= _LONGEST_TOKEN, "no token of a ROS name", token)
    ensure(not token.endswith("_"), "a token ends in an underscore", token)
