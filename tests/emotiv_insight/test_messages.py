"""What Cortex sends, read: every vector, and anything else that could come."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.emotiv_insight.driver import protocol
from biosensor_gateway.devices.emotiv_insight.driver.messages import (
    STREAMS,
    Data,
    Event,
    Fault,
    FaultCode,
    Reply,
    Warned,
    parse,
)
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Decoder, Sample, layout

FILE = Path(__file__).parent / "vectors" / "emotiv_cortex.json"
VECTORS: list[dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))["vectors"]
SID = "866b8437-2380-4392-9a35-3d5957eaf95d"
SIDS = {
    vector["message"]["sid"] for vector in VECTORS if vector["category"] == "stream"
}  # The rules of the file: all of them are known before the replay.
# What the vectors call by other names than the columns.
LABELS = {
    "counter": ("COUNTER", "COUNTER_MEMS"),
    "interpolated": ("INTERPOLATED", "INTERPOLATED_MEMS"),
    "raw_cq": ("RAW_CQ",),
    "marker_hardware": ("MARKER_HARDWARE",),
    "markers": ("MARKERS",),
    "battery_level": ("Battery",),
    "signal": ("Signal",),
    "overall": ("OVERALL", "overall"),
    "battery_percent": ("BatteryPercent", "batteryPercent"),
    "sample_rate_quality": ("sampleRateQuality",),
    "action": ("act",),
    "power": ("pow",),
    "eye": ("eyeAct",),
    "upper": ("uAct",),
    "upper_power": ("uPow",),
    "lower": ("lAct",),
    "lower_power": ("lPow",),
}


# Whether somebody waits for a reply, only the client knows: test_cortex.py has this one.
UNKNOWN_ID = "mal_unknown_id"


def named(category: str) -> list[Any]:
    return [
        pytest.param(vector, id=vector["name"])
        for vector in VECTORS
        if vector["category"] == category and vector["name"] != UNKNOWN_ID
    ]


def text(vector: dict[str, Any]) -> str:
    return vector.get("raw") or json.dumps(vector["message"])


def decoded(vector: dict[str, Any]) -> Sample | Fault:
    """Read a vector as the driver does; a message that is no sample is returned as a fault."""
    message = parse(text(vector))
    if not isinstance(message, Data):
        assert isinstance(message, Fault)
        return message
    decoder = Decoder()
    columns = layout(vector.get("cols"))
    for sid in SIDS:
        decoder.subscribed(sid, {} if columns is None else {message.stream: columns})
    return decoder.decode(message)


def same(value: object, expected: object) -> bool:
    if expected is None:
        return isinstance(value, float) and math.isnan(value)
    if isinstance(expected, int | float):
        return value == pytest.approx(float(expected), abs=1e-9)
    return value == expected


def values_of(expect: dict[str, Any]) -> dict[str, Any]:
    """Return what a vector expects, by the labels of its columns."""
    values: dict[str, Any] = {}
    for key in ("channels", "values", "metrics", "contact_quality", "quality"):
        if isinstance(expect.get(key), dict):
            values |= expect[key]
    values |= {f"{name}.isActive": active for name, active in expect.get("active", {}).items()}
    return values


@pytest.mark.parametrize("vector", named("stream"))
def test_samples_are_decoded_by_their_columns(vector: dict[str, Any]) -> None:
    sample, expect = decoded(vector), vector["expect"]
    assert isinstance(sample, Sample)
    assert (sample.stream, sample.time_s) == (expect["stream"], expect["t"])
    found = {**sample.numbers, **sample.others}
    for label, expected in values_of(expect).items():
        assert same(found[label], expected), label
    for key in expect.keys() & LABELS.keys():
        (label,) = set(LABELS[key]) & found.keys()
        assert same(found[label], expect[key]), label
    if isinstance(expect.get("values"), list):
        assert list(found.values()) == expect["values"]


@pytest.mark.parametrize("vector", named("malformed"))
def test_what_is_malformed_is_a_fault_or_has_no_value(vector: dict[str, Any]) -> None:
    found, expect = decoded(vector), vector["expect"]
    if expect["kind"] == "fault":
        assert found == Fault(FaultCode(expect["code"]))
    else:
        assert isinstance(found, Sample)
        for label, expected in expect["channels"].items():
            assert same(found.numbers[label], expected)


@pytest.mark.parametrize("vector", named("error"))
def test_errors_are_told_apart_by_their_codes(vector: dict[str, Any]) -> None:
    reply = parse(text(vector))
    assert isinstance(reply, Reply)
    assert reply.error is not None
    assert (reply.request_id, reply.error.code) == (7, vector["expect"]["code"])
    assert reply.error.kind.value == vector["expect"]["class"]


@pytest.mark.parametrize("vector", named("warning"))
def test_warnings_are_told_apart_by_their_codes(vector: dict[str, Any]) -> None:
    warned, expect = parse(text(vector)), vector["expect"]
    assert isinstance(warned, Warned)
    assert (warned.code, warned.event.value) == (expect["code"], expect["event"])
    assert warned.headset == expect.get("headset", "")


@pytest.mark.parametrize("vector", named("response"))
def test_results_are_read(vector: dict[str, Any]) -> None:
    reply, expect = parse(text(vector)), vector["expect"]
    assert isinstance(reply, Reply)
    assert reply.error is None
    match expect["method"]:
        case "getCortexInfo":
            assert protocol.version(reply.result) == expect["version"]
        case "getUserLogin":
            login = protocol.login(reply.result)
            assert login == protocol.Login(expect["logged_in"], expect["same_os_user"])
        case "authorize":
            assert protocol.token(reply.result) == expect["token"]
            assert protocol.eula_missing(reply.result) is expect["eula_warning"]
        case "createSession":
            session = protocol.session(reply.result)
            assert (session.session_id, session.status) == (expect["session"], expect["status"])
            assert session.is_active is expect["activated"]
        case "subscribe":
            subscription = protocol.subscription(reply.result)
            assert sorted(subscription.layouts) == sorted(expect["ok"])
            assert subscription.failures == expect["failed"]
            assert subscription.session_id == vector["message"]["result"]["success"][0]["sid"]
        case method:
            pytest.fail(f"no test for {method}")


def test_every_category_is_tested() -> None:
    tested = {"stream", "malformed", "error", "warning", "response"}
    assert {vector["category"] for vector in VECTORS} == tested
    assert len(VECTORS) == 78


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=12,
)
KEYS = ["sid", "time", "warning", "id", "result", "error", "code", "message", "attention", "eeg"]


def keyed(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.dictionaries(st.sampled_from(KEYS), inner)


@given(st.text() | (JSON | keyed(JSON | keyed(JSON))).map(json.dumps))
def test_no_text_makes_the_reader_fail(message: str) -> None:
    assert isinstance(parse(message), Data | Fault | Reply | Warned)


@pytest.mark.parametrize(
    "message", ["[" * 100_000, "9" * 5000, '{"id":1e999}', "\x00", "{" * 99_999]
)
def test_no_absurd_text_makes_the_reader_fail(message: str) -> None:
    assert isinstance(parse(message), Fault)


LABEL = st.text(max_size=4)


@given(
    cols=st.lists(LABEL | st.lists(LABEL, max_size=3) | JSON, max_size=6),
    values=st.lists(JSON, max_size=6),
    stream=st.sampled_from(sorted(STREAMS)),
)
def test_no_columns_and_values_make_the_decoder_fail(
    cols: list[Any], values: list[Any], stream: str
) -> None:
    columns, decoder = layout(cols), Decoder()
    decoder.subscribed(SID, {} if columns is None else {stream: columns})
    decoded = decoder.decode(Data(stream, SID, 1.0, values))
    if isinstance(decoded, Sample):
        assert columns is not None
        assert decoded.numbers.keys() | decoded.others.keys() == columns.labels
        assert not any(map(math.isinf, decoded.numbers.values()))


@given(JSON | keyed(JSON))
def test_no_result_makes_its_reader_fail(result: object) -> None:
    for read in (protocol.version, protocol.login, protocol.access_granted, protocol.eula_missing,
                 protocol.headsets, protocol.sessions, protocol.subscription):  # fmt: skip
        read(result)


@given(st.text(), st.text())
def test_only_the_code_of_a_warning_decides(first: str, second: str) -> None:
    for words in (first, second):
        warned = parse(json.dumps({"warning": {"code": 103, "message": words}}))
        assert isinstance(warned, Warned)
        assert warned.event is Event.HEADSET_LOST


def test_a_text_that_is_no_unicode_is_made_so() -> None:
    warned = parse('{"warning":{"code":1,"message":{"sessionId":"\\ud800"}}}')
    assert isinstance(warned, Warned)
    assert warned.session == "?"


@pytest.mark.parametrize(
    ("nested", "fault"),
    [([1, 2], None), (None, None), ([1], FaultCode.LENGTH_MISMATCH), (3, FaultCode.BAD_TYPE)],
)
def test_a_nested_column_has_nested_values(nested: object, fault: FaultCode | None) -> None:
    columns, decoder = layout(["Battery", ["AF3", "OVERALL"]]), Decoder()
    assert columns is not None
    decoder.subscribed(SID, {"dev": columns})
    sample = decoder.decode(Data("dev", SID, 1.0, [4, nested]))
    assert sample == Fault(fault) if fault else isinstance(sample, Sample)


@pytest.mark.parametrize("cols", [None, [], "COUNTER", [1], [[]], [["a", 2]], {"a": 1}])
def test_what_is_no_list_of_labels_is_no_layout(cols: object) -> None:
    assert layout(cols) is None
    answer = {"success": [{"streamName": "eeg", "cols": cols, "sid": SID}], "failure": []}
    assert protocol.subscription(answer) == protocol.Subscription({}, {"eeg": 0}, "")
