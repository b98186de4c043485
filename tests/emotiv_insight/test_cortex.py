"""The JSON-RPC client: replies in any order, late or twice, and what Cortex sends."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError, TransportReason
from biosensor_gateway.devices.emotiv_insight.driver import cortex as module
from biosensor_gateway.devices.emotiv_insight.driver import protocol
from biosensor_gateway.devices.emotiv_insight.driver.cortex import (
    KEPT_WARNINGS,
    CortexClient,
    CortexError,
)
from biosensor_gateway.devices.emotiv_insight.driver.messages import (
    STREAMS,
    Data,
    ErrorKind,
    Event,
    Fault,
    FaultCode,
    Reply,
    Warned,
    parse,
)
from biosensor_gateway.devices.emotiv_insight.driver.protocol import Decoder, Sample, layout
from biosensor_gateway.transports.link import ReceivedText
from biosensor_gateway.transports.websocket import WebSocketLink

# The JSON-RPC client: replies in any order, late, twice or never; junk in between.

SECRET = "planted-secret"


class FakeLink:
    """A link whose other end is the test."""

    def __init__(self) -> None:
        self.dropped = 0
        self.sent: list[dict[str, Any]] = []
        self._coming: asyncio.Queue[ReceivedText | TransportError] = asyncio.Queue()
        self._arrival = 0.0

    async def open(self) -> None: ...
    async def close(self) -> None: ...

    async def send(self, text: str) -> None:
        self.sent.append(json.loads(text))

    async def read(self) -> ReceivedText:
        item = await self._coming.get()
        if isinstance(item, TransportError):
            raise item
        return item

    def come(self, *messages: object) -> None:
        for message in messages:
            text = message if isinstance(message, str) else json.dumps(message)
            self._arrival += 1
            self._coming.put_nowait(ReceivedText(text, self._arrival))

    def end(self) -> None:
        self._coming.put_nowait(TransportError(TransportReason.LOST, "cut"))


async def settled(condition: Callable[[], bool] = lambda: False) -> None:
    """Let all that is ready run; nothing here waits for anything outside."""
    for _ in range(200):
        if condition():
            return
        await asyncio.sleep(0)


@pytest.fixture
async def link() -> FakeLink:
    return FakeLink()


@pytest.fixture
async def client(link: FakeLink) -> CortexClient:
    opened = CortexClient(cast("WebSocketLink", link))
    await opened.open()
    return opened


async def started(client: CortexClient, *methods: str) -> list[asyncio.Task[object]]:
    tasks = [asyncio.create_task(client.call(method, {"a": 1})) for method in methods]
    await settled()
    return tasks


@given(st.permutations(range(5)))
def test_replies_find_their_requests_in_any_order(order: list[int]) -> None:
    async def converse() -> list[object]:
        link = FakeLink()
        client = CortexClient(cast("WebSocketLink", link))
        await client.open()
        tasks = await started(client, *"abcde")
        for index in order:
            link.come({"id": link.sent[index]["id"], "result": link.sent[index]["method"]})
        results = await asyncio.gather(*tasks)
        await client.close()
        return results

    assert asyncio.run(converse()) == list("abcde")


async def test_a_request_is_json_rpc_with_an_id_of_its_own(
    client: CortexClient, link: FakeLink
) -> None:
    tasks = await started(client, "getCortexInfo", "getUserLogin")
    first, second = link.sent
    assert first == {"jsonrpc": "2.0", "id": 1, "method": "getCortexInfo", "params": {"a": 1}}
    assert second["id"] != first["id"]
    await client.close()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_an_error_tells_its_code_and_its_kind(client: CortexClient, link: FakeLink) -> None:
    (task,) = await started(client, "subscribe")
    link.come({"id": 1, "error": {"code": -32015, "message": "expired"}})
    with pytest.raises(CortexError, match=r"refuses subscribe: expired \(-32015\)") as raised:
        await task
    assert (raised.value.code, raised.value.kind) == (-32015, ErrorKind.TOKEN)


@pytest.mark.parametrize("error", [{"code": -5}, {}, [], "text", {"code": True}, {"message": 4}])
async def test_an_error_may_lack_anything(
    client: CortexClient, link: FakeLink, error: object
) -> None:
    (task,) = await started(client, "subscribe")
    link.come({"id": 1, "error": error})
    with pytest.raises(CortexError) as raised:
        await task
    assert raised.value.kind is ErrorKind.OTHER


async def test_no_reply_is_an_error_and_a_late_one_answers_nobody(
    client: CortexClient, link: FakeLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "REPLY_TIMEOUT_S", 0.05)
    with pytest.raises(ProtocolError) as raised:
        await client.call("getUserLogin")
    assert raised.value.reason is ProtocolReason.NO_REPLY
    monkeypatch.setattr(module, "REPLY_TIMEOUT_S", 10.0)
    (task,) = await started(client, "getUserLogin")
    link.come(
        {"id": 1, "result": "late"}, {"id": 2, "result": "mine"}, {"id": 2, "result": "twice"}
    )
    assert await task == "mine"
    await settled(lambda: client.faults[FaultCode.UNKNOWN_ID] == 2)
    assert client.faults == {FaultCode.UNKNOWN_ID: 2}


async def test_a_reply_that_nobody_waits_for_is_counted(
    client: CortexClient, link: FakeLink
) -> None:
    link.come({"jsonrpc": "2.0", "id": 424242, "result": {}})
    await settled(lambda: bool(client.faults))
    assert client.faults == {FaultCode.UNKNOWN_ID: 1}


@pytest.mark.parametrize("how", ["link", "close"])
async def test_every_request_ends_when_the_connection_does(
    client: CortexClient, link: FakeLink, how: str
) -> None:
    tasks = await started(client, "a", "b")
    waiting = asyncio.create_task(client.next_data())
    await settled()
    if how == "link":
        link.end()
    else:
        await client.close()
    for task in (*tasks, waiting):
        with pytest.raises(TransportError) as raised:
            await task
        assert raised.value.reason is TransportReason.LOST
    with pytest.raises(TransportError):
        await client.call("c")


async def test_what_had_arrived_is_read_before_the_end_is_told(
    client: CortexClient, link: FakeLink
) -> None:
    link.come(*({"eeg": [number], "sid": "s", "time": 1.0} for number in range(3)))
    link.end()
    arrived = [await client.next_data() for _ in range(3)]
    assert [each.data.values for each in arrived] == [[0], [1], [2]]
    assert [each.arrival for each in arrived] == [1, 2, 3]
    with pytest.raises(TransportError):
        await client.next_data()


async def test_samples_that_nobody_takes_are_dropped_oldest_first_and_counted(
    client: CortexClient, link: FakeLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "KEPT_SAMPLES", 3)
    (task,) = await started(client, "subscribe")
    link.come(*({"eeg": [number], "sid": "s", "time": 1.0} for number in range(5)))
    link.come({"id": 1, "result": None})
    await task
    assert [(await client.next_data()).data.values for _ in range(3)] == [[2], [3], [4]]
    assert client.dropped_messages == 2


async def test_junk_is_counted_and_hides_nothing(client: CortexClient, link: FakeLink) -> None:
    (task,) = await started(client, "getUserLogin")
    junk = ["{", "[1]", '{"eeg":[NaN],"sid":"s","time":1}', "{}", '{"xyz":[1],"sid":"s","time":1}']
    with capture_logs() as logs:
        link.come(*junk, *junk, {"id": 1, "result": "mine"})
        assert await task == "mine"
    assert sum(client.faults.values()) == 10
    assert client.dropped_bytes == 2 * sum(map(len, junk))
    assert len(logs) == 5


async def test_a_watch_gets_its_warnings_for_as_long_as_it_lasts(
    client: CortexClient, link: FakeLink
) -> None:
    with client.warnings.watching(Event.HEADSET_CONNECTED) as heard:
        link.come({"warning": {"code": 104}}, {"warning": {"code": 142}})
        link.come({"id": 9, "result": [], "attention": {"code": 31, "message": "Bluetooth"}})
        assert (await heard.get()).code == 104
        await settled()
        assert heard.empty()
    forever = client.warnings.watch(Event.BLUETOOTH_DENIED)
    link.come({"warning": {"code": 104}})
    link.come({"id": 9, "result": [], "attention": {"code": 31, "message": "Bluetooth"}})
    assert (await forever.get()).text == "Bluetooth"
    assert heard.empty()


async def test_a_watch_does_not_grow_without_limit(client: CortexClient, link: FakeLink) -> None:
    heard = client.warnings.watch(Event.SCAN_FINISHED)
    link.come(*[{"warning": {"code": 142}}] * 1000)
    (task,) = await started(client, "a")
    link.come({"id": 1, "result": 1})
    await task
    assert heard.qsize() == KEPT_WARNINGS


async def test_a_secret_that_cortex_quotes_is_not_repeated(
    client: CortexClient, link: FakeLink
) -> None:
    client.warnings.hide(SECRET)
    client.warnings.hide("")
    (task,) = await started(client, "authorize")
    with capture_logs() as logs:
        link.come({"warning": {"code": 6, "message": f"no {SECRET}!"}})
        link.come({"id": 1, "error": {"code": -32021, "message": f"bad {SECRET}!"}})
        with pytest.raises(CortexError, match=r"bad \*\*\*!"):
            await task
    assert "no ***!" in str(logs)
    assert SECRET not in str(logs)


# What Cortex sends, read: every vector, and anything else that could come.
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
