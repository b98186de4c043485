"""The description of an LSL stream, which any program of the network may have written.

It is read, or refused with a SpecError; what was read has a valid topic, fits the
stream, and says the same when it is read again.
"""

from __future__ import annotations

import math
import re

from biosensor_common import naming
from biosensor_common.errors import SpecError
from biosensor_common.lsl_header import MAX_CHANNELS, read_header
from biosensor_common.quantities import ChannelFormat
from biosensor_common.spec import is_data_name
from biosensor_common.stream_header import MAX_FIELD_CHARACTERS, StreamHeader
from tests.fuzz.contract import ensure

_TOPIC = re.compile(r"[A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z][A-Za-z0-9_]*)*")


def check(data: bytes) -> None:
    """Read the description; bytes that are no UTF-8 come as pylsl gives them."""
    xml = data.decode("utf-8", "surrogateescape")
    try:
        header = read_header(xml)
    except SpecError as error:
        ensure(str(error) != "", "a refusal without a reason", error)
        return
    ensure(header == read_header(xml), "it is read in two ways", header)
    _fits(header)
    topic = naming.topic(header.identity, header.data_name)
    ensure(_TOPIC.fullmatch(topic) is not None and "__" not in topic, "no topic", topic)


def _fits(header: StreamHeader) -> None:
    count = len(header.labels)
    counts = {count, len(header.units), len(header.roles)}
    ensure(0 < count <= MAX_CHANNELS and len(counts) == 1, "bad channels", header)
    roles = zip(header.roles, header.units, strict=True)
    ensure(all(role is None or role.unit == unit for role, unit in roles), "bad role", header)
    ensure(not (header.is_state and header.rate), "a state with a rate", header)
    ensure(math.isfinite(header.rate) and header.rate >= 0, "bad rate", header)
    texts = (*header.labels, *header.units)
    ensure(max(map(len, texts)) <= MAX_FIELD_CHARACTERS, "a text is too long", header)
    is_text = header.format is ChannelFormat.STRING
    ensure(is_text == header.message_type.is_text, "another message type", header)
    if header.foreign:
        ensure(not any(header.roles) and not header.is_state, "a foreign meaning", header)
    else:
        names = (header.identity.sensor, header.data_name, header.chunk or "ok")
        ensure(all(map(is_data_name, names)), "a name is no ROS name", header)
