"""Messages of Cortex, one a line as WebSocket text.

`parse`, the decoder and the readers of results raise nothing but the ProtocolError that
they name; what is text can be written anywhere; a sample's numbers are finite or NaN.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from typing import Any, cast

from biosensor_common.errors import ConfigError, ProtocolError
from biosensor_gateway.devices.emotiv_insight.driver import protocol
from biosensor_gateway.devices.emotiv_insight.driver.emitter import EmotivEmitter
from biosensor_gateway.devices.emotiv_insight.driver.messages import Data, Reply, Warned, parse
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Decoder, Sample
from biosensor_gateway.devices.emotiv_insight.driver.session import chosen
from tests.fuzz.breaking import Fault, instead
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, vectors

# Vectors that test size alone are tested elsewhere.
_MAX_BYTES = 8192

_READERS: tuple[Callable[[object], object], ...] = (
    protocol.version,
    protocol.login,
    protocol.access_granted,
    protocol.token,
    protocol.eula_missing,
    protocol.session,
    protocol.sessions,
)


def check(data: bytes) -> None:
    """Read the messages in their order, as of one connection."""
    decoder = Decoder()
    emitter = EmotivEmitter(CheckedSink("emotiv_insight"))
    emitter.connected(128.0, 64.0, headset_stayed=True)
    for number, line in enumerate(data.decode("utf-8", "replace").split("\n")):
        message = parse(line)
        match message:
            case Data():
                sample = decoder.decode(message)
                if isinstance(sample, Sample):
                    _is_sane(sample)
                    emitter.take(sample, ARRIVAL_S + number)
            case Reply():
                _read(message.result, decoder)
                if message.error is not None:
                    _can_be_written(message.error.kind.name + message.error.text)
            case Warned():
                for text in (message.event.name, message.text, message.headset, message.session):
                    _can_be_written(text)
            case _:
                pass


def _is_sane(sample: Sample) -> None:
    ensure(math.isfinite(sample.time_s), "a sample has no time", sample)
    ensure(not any(map(math.isinf, sample.numbers.values())), "it is no number", sample)


def _read(result: object, decoder: Decoder) -> None:
    for read in _READERS:
        try:
            read(result)
        except ProtocolError:
            continue
    headsets = protocol.headsets(result)
    for headset in headsets:
        _can_be_written(headset.headset_id + headset.name + headset.firmware)
    try:
        chosen(headsets, "")
    except ConfigError as error:
        _can_be_written(str(error))
    subscription = protocol.subscription(result)
    decoder.subscribed(subscription.session_id, subscription.layouts)


def _can_be_written(text: str) -> None:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        ensure(False, "a text cannot be written", text, error)


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    lines: list[str] = []
    for vector in vectors("emotiv_insight/vectors/emotiv_cortex.json"):
        line = vector["raw"] if "raw" in vector else json.dumps(vector["message"])
        data: str = line
        if "cols" in vector:
            message = cast("dict[str, Any]", vector.get("message", {}))
            success = {
                "streamName": next((key for key in message if key != "sid"), "eeg"),
                "cols": vector["cols"],
                "sid": message.get("sid", ""),
            }
            reply = {"id": 7, "result": {"success": [success], "failure": []}}
            data = f"{json.dumps(reply)}\n{line}"
        lines.append(data)
        yield vector["name"], data.encode("utf-8", "replace")
    yield "odd_huge_number", b'{"id":1,"result":{"failure":[{"code":1' + b"0" * 400 + b"}]}}"
    yield "odd_nested", b'{"sid":' + b"[" * 3000
    yield "all", "\n".join(lines).encode("utf-8", "replace")[:_MAX_BYTES]


def _any_columns(columns: Sequence[object], values: Sequence[object]) -> object:
    return zip(columns, values, strict=True)


FAULT: Fault = (
    "biosensor_gateway.devices.emotiv_insight.driver.protocol",
    "_labelled",
    instead(_any_columns),
)
"""How the reader is broken to see that the corpus finds it."""
