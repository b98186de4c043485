"""The JSON-RPC client: replies in any order, late, twice or never; junk in between."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.emotiv_insight.driver import cortex as module
from biosensor_gateway.devices.emotiv_insight.driver.cortex import (
    KEPT_WARNINGS,
    CortexClient,
    CortexError,
)
from biosensor_gateway.devices.emotiv_insight.driver.messages import ErrorKind, Event, FaultCode
from biosensor_gateway.transports.link import ReceivedText
from biosensor_gateway.transports.websocket import WebSocketLink

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
