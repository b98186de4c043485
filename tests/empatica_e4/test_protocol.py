"""The E4 text protocol: every vector, and any bytes in any pieces."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.empatica_e4.driver.protocol import (
    MAX_LINE_BYTES,
    E4Protocol,
    Event,
    Flaw,
    Malformed,
    Message,
    Reply,
    Sample,
    request,
)

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/empatica_e4.json").read_text(encoding="utf-8")
)["vectors"]
TOLERANCE = 1e-6
LINES = (
    b"E4_Bvp 1680442024,64479 21,54169\r\n"
    b"R device_subscribe gsr OK\n"
    b"E4_Acc 1680442024.5 -1 2 63\r\n"
    b"R connection lost to device 9ff167\n"
    b"E4_Gsr 1680442024,73 0,0832364\r\n\r\n"
    b"nonsense\r\nE4_Tag 1680442031,5\r\n"
    b"R device_list 2 | 9ff167 Empatica_E4 | 7a3166 Empatica_E4 not_allowed\n"
)


def _chunks(vector: dict[str, Any]) -> list[bytes]:
    chunks: list[str] = vector.get("chunks") or [vector["message"]]
    return [
        bytes.fromhex(chunk[4:]) if chunk.startswith("hex:") else chunk.encode("utf-8")
        for chunk in chunks
        if chunk != "<EOF>"
    ]


def _check(message: Message, expected: dict[str, Any]) -> None:
    match message:
        case Sample():
            assert expected["kind"] == "sample"
            assert message.stream.value == expected["stream"]
            assert message.time_s == pytest.approx(expected["t"], abs=TOLERANCE, rel=0)
            assert message.values == pytest.approx(expected["values"], abs=TOLERANCE, rel=0)
        case Reply():
            assert expected["kind"] == "reply"
            assert message.command == expected["command"]
            assert message.accepted == (expected["status"] == "ok")
            assert message.subject == expected.get("stream", expected.get("state", ""))
        case Event():
            assert expected["kind"] == "event"
            assert message.event.value == expected["event"]
            assert message.device == expected["device"].lower()
        case Malformed():
            assert expected["kind"] == "error"
            assert message.flaw.value == expected["code"]
            if "raw" in expected:
                assert message.raw == expected["raw"]


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["name"])
def test_vector(vector: dict[str, Any]) -> None:
    protocol = E4Protocol()
    messages = [message for chunk in _chunks(vector) for message in protocol.feed(chunk)]
    if "<EOF>" in vector.get("chunks", ()):
        messages += protocol.finish()
    expected = [each for each in vector["expect"] if each["kind"] != "closed"]
    assert len(messages) == len(expected)
    for message, wanted in zip(messages, expected, strict=True):
        _check(message, wanted)


def test_events_of_a_wristband_are_no_replies() -> None:
    (back, off) = E4Protocol().feed(
        b"R connection re-established to device 9FF167\nR device 9ff167 turned off via button\n"
    )
    assert isinstance(back, Event)
    assert isinstance(off, Event)
    assert (back.event.value, off.event.value) == ("ble_restored", "turned_off")
    assert back.device == off.device == "9ff167"


@pytest.mark.parametrize("time", ["0", "-1680442024", "1680442024644790", "1e11"])
def test_a_time_that_no_clock_reads_is_refused(time: str) -> None:
    line = f"E4_Bvp {time} 21,54169"
    (malformed,) = E4Protocol().feed(f"{line}\n".encode())
    assert malformed == Malformed(Flaw.BAD_NUMBER, line)


def test_a_device_list_says_who_may_connect() -> None:
    (reply,) = E4Protocol().feed(
        b"R device_discover_list 2 | 9FF167 Empatica_E4 allowed | 7a3166 Empatica_E4 not_allowed\n"
    )
    assert isinstance(reply, Reply)
    assert [(each.device, each.allowed) for each in reply.devices] == [
        ("9ff167", True),
        ("7a3166", False),
    ]


@pytest.mark.parametrize("word", ["ERR", "ERROR"])
def test_a_refusal_keeps_its_reason(word: str) -> None:
    (reply,) = E4Protocol().feed(f"R device_subscribe {word} You are not connected\n".encode())
    assert isinstance(reply, Reply)
    assert not reply.accepted
    assert reply.reason == "You are not connected"


def test_requests_end_as_every_server_accepts() -> None:
    assert request("device_subscribe", "bvp", "ON") == b"device_subscribe bvp ON\r\n"


def _split(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted({cut % (len(data) + 1) for cut in cuts}), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


NOISE = st.lists(
    st.one_of(
        st.binary(max_size=40),
        st.sampled_from([LINES, b"\r", b"\n", b"E4_", b"R ", b"E4_Bvp 1,5 2,5\r\n", b"E4_Acc "]),
        st.text(max_size=20).map(lambda text: text.encode("utf-8", "ignore")),
    ),
    max_size=12,
).map(b"".join)


@given(data=NOISE, cuts=st.lists(st.integers(0, 10_000), max_size=20))
def test_any_bytes_in_any_pieces_mean_the_same(data: bytes, cuts: list[int]) -> None:
    whole, pieces = E4Protocol(), E4Protocol()
    expected = [*whole.feed(data), *whole.finish()]
    messages = [message for part in _split(data, cuts) for message in pieces.feed(part)]
    messages += pieces.finish()
    assert messages == expected
    assert pieces.dropped_bytes == whole.dropped_bytes


@given(pieces=st.lists(st.integers(1, 30_000), min_size=1, max_size=12))
def test_a_runaway_line_is_dropped_once_and_never_kept(pieces: list[int]) -> None:
    protocol, messages = E4Protocol(), list[Message]()
    for size in pieces:
        messages += protocol.feed(b"x" * size)
        assert protocol.buffered <= MAX_LINE_BYTES
    messages += protocol.feed(b"\nR pause ON\n")
    flaws = [message.flaw.value for message in messages if isinstance(message, Malformed)]
    assert flaws == (["line_too_long"] if sum(pieces) > MAX_LINE_BYTES else ["unknown_line"])
    assert isinstance(messages[-1], Reply)
