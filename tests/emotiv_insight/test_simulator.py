"""The virtual Cortex, as a plain JSON-RPC client finds it, and what can befall it."""

from __future__ import annotations

import asyncio
import itertools
import json
import ssl
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self, cast

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from biosensor_gateway.devices.emotiv_insight.simulator import (
    INSIGHT_1,
    INSIGHT_1_GYRO,
    INSIGHT_2,
    Circumstances,
    Metrics,
    Model,
    Release,
)
from biosensor_gateway.simulation.world import World
from tests.emotiv_insight.steering import SteeredCortex
from tests.rigs.polling import until

DEADLINE_S = 20.0
_QUERY_EVERY_S = 0.02


class CortexError(Exception):
    """A request that was answered with an error; ``code`` says which."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class CortexClient:
    """One connection; an async context manager."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.settings = settings
        # Data messages by stream, in order.
        self.data: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
        self.warnings: list[dict[str, Any]] = []  # Warnings, in order.
        self._ids = itertools.count(1)
        self._pending: dict[int, asyncio.Future[dict[str, Any]]] = {}

    async def __aenter__(self) -> Self:
        self.socket: ClientConnection = await connect(
            self.settings["url"],
            ssl=_lenient(self.settings["ca_file"]),
            proxy=None,
            compression=None,
            open_timeout=DEADLINE_S,
            ping_interval=None,
            close_timeout=1.0,
        )
        self._reader = asyncio.create_task(self._read())
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.socket.close()
        await self._reader

    async def send(self, method: str, **params: Any) -> asyncio.Future[dict[str, Any]]:
        """Send a request; the future gets the whole reply."""
        number = next(self._ids)
        self._pending[number] = asyncio.get_running_loop().create_future()
        await self.socket.send(
            json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params})
        )
        return self._pending[number]

    async def ask(self, method: str, **params: Any) -> Any:
        """Send a request and return its result; raise CortexError where it is refused."""
        reply = await asyncio.wait_for(await self.send(method, **params), DEADLINE_S)
        if "error" in reply:
            raise CortexError(reply["error"]["code"])
        return reply["result"]

    async def until(self, condition: Callable[[], Any]) -> None:
        """Wait for a condition."""
        await until(condition)

    async def until_warned(self, code: int) -> dict[str, Any]:
        """Wait for a warning of this code and return it."""
        await self.until(lambda: code in self.warning_codes)
        return next(warning for warning in self.warnings if warning["code"] == code)

    async def until_data(self, stream: str, more: int = 1) -> None:
        """Wait for so many more messages of a stream."""
        wanted = len(self.data[stream]) + more
        await self.until(lambda: len(self.data[stream]) >= wanted)

    @property
    def warning_codes(self) -> list[int]:
        """Codes of the warnings so far."""
        return [warning["code"] for warning in self.warnings]

    async def authorize(self, client_id: str, client_secret: str, **params: Any) -> str:
        """Return a token."""
        result = await self.ask(
            "authorize", clientId=client_id, clientSecret=client_secret, **params
        )
        return result["cortexToken"]

    async def connect_headset(self) -> None:
        """Scan, connect and wait until the headset is connected."""
        headset = self.settings["headset"]
        await self.ask("controlDevice", command="refresh")
        for _ in range(round(DEADLINE_S / _QUERY_EVERY_S)):
            if await self.ask("queryHeadsets", id=headset):
                break
            await asyncio.sleep(_QUERY_EVERY_S)
        await self.ask("controlDevice", command="connect", headset=headset)
        await self.until_warned(104)

    async def begin(
        self, client_id: str, client_secret: str, *streams: str, status: str = "active"
    ) -> tuple[str, str]:
        """Go the whole way to streaming; return token and session."""
        token = await self.authorize(client_id, client_secret, debit=10)
        await self.connect_headset()
        session = await self.ask(
            "createSession", cortexToken=token, headset=self.settings["headset"], status=status
        )
        if streams:
            result = await self.ask(
                "subscribe", cortexToken=token, session=session["id"], streams=list(streams)
            )
            assert [one["streamName"] for one in result["success"]] == list(streams)
        return token, session["id"]

    async def _read(self) -> None:
        with suppress(ConnectionClosed):
            async for text in self.socket:
                self._sort(text)

    def _sort(self, text: str | bytes) -> None:
        message = _read_object(text)
        if "sid" in message and "time" in message:
            stream = next(key for key in message if key not in {"sid", "time"})
            self.data[stream].append(message)
        elif isinstance(message.get("warning"), dict):
            self.warnings.append(message["warning"])
        elif message.get("id") in self._pending:
            self._pending.pop(message["id"]).set_result(message)


def _read_object(text: str | bytes) -> dict[str, Any]:
    """Decode a message; nothing where it is not a JSON object."""
    try:
        message = json.loads(text, parse_constant=_reject)
    except ValueError:
        return {}
    return cast("dict[str, Any]", message) if isinstance(message, dict) else {}


def _reject(constant: str) -> None:
    raise ValueError(constant)


def _lenient(ca_file: str) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=ca_file)
    # From Python 3.13 on it is set; the vendor's authority lacks an extension that it wants.
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT
    return context


# The virtual Cortex, as a plain JSON-RPC client finds it.

APP = (SteeredCortex.client_id, SteeredCortex.client_secret)
CREDENTIALS = dict(zip(("clientId", "clientSecret"), APP, strict=True))
_VECTORS = json.loads((Path(__file__).parent / "vectors/emotiv_cortex.json").read_text("utf-8"))
VECTORS = {vector["name"]: vector for vector in _VECTORS["vectors"]}


def shape(value: Any) -> Any:
    """Keys and types of a message, without its values."""
    match value:
        case dict():
            fields = cast("dict[str, Any]", value)
            return {key: shape(inner) for key, inner in fields.items()}
        case list():
            return [shape(inner) for inner in cast("list[Any]", value)]
        case bool() | str() | None:
            return type(value)
        case _:
            return float


async def test_replies_have_the_shape_of_the_vectors(world: World) -> None:
    with SteeredCortex(
        world,
        Circumstances(release=Release("3.8.1")),
        model=INSIGHT_2,
        seed=2,
    ) as cortex:
        async with CortexClient(cortex.settings) as client:
            replies = {
                "res_getCortexInfo_v4": await (await client.send("getCortexInfo")),
                "res_getUserLogin_other_os_user": await (await client.send("getUserLogin")),
                "res_authorize": await (await client.send("authorize", **CREDENTIALS)),
            }
            token = replies["res_authorize"]["result"]["cortexToken"]
            await client.connect_headset()
            created = await (await client.send("createSession", cortexToken=token, status="active"))
            replies["res_createSession_activated_v3"] = created
            for name, reply in replies.items():
                assert shape(reply) == shape(VECTORS[name]["message"])
            known = VECTORS["res_createSession_activated_v3"]["message"]["result"]
            assert created["result"]["headset"] == known["headset"]
            assert created["result"]["performanceMetrics"] == known["performanceMetrics"]


@pytest.mark.parametrize(
    ("vector", "reported"), [("warn_104_headset_connected", 104), ("warn_142_scan_finished", 142)]
)
async def test_warnings_have_the_shape_of_the_vectors(
    world: World, vector: str, reported: int
) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            await client.connect_headset()
            warning = await client.until_warned(reported)
            assert shape(warning) == shape(VECTORS[vector]["message"]["warning"])


# What the virtual headset measures: data against truth, columns, counters and times.

STREAMS = ("eeg", "mot", "pow", "met", "dev")
ELECTRODES = ["AF3", "T7", "Pz", "T8", "AF4"]


class Recording:
    """Some seconds of a client's data, with the columns of the subscription."""

    def __init__(self, client: CortexClient, columns: dict[str, list[Any]]) -> None:
        self.client = client
        self.columns = columns


async def record(cortex: SteeredCortex, eeg_samples: int, *streams: str) -> Recording:
    """Stream until so many EEG samples and one of each other stream are there; stop."""
    async with CortexClient(cortex.settings) as client:
        token, session = await client.begin(*APP)
        own = {"cortexToken": token, "session": session}
        subscribed = await client.ask("subscribe", **own, streams=list(streams))
        await client.until_data("eeg", eeg_samples)
        await client.until(lambda: all(client.data[stream] for stream in streams))
        await client.ask("unsubscribe", **own, streams=list(streams))
    return Recording(client, {one["streamName"]: one["cols"] for one in subscribed["success"]})


@pytest.mark.parametrize(
    ("version", "metrics", "eeg_last", "dev", "met"),
    [
        ("2.0.3", None, "MARKER_HARDWARE", ["Battery", "Signal", ELECTRODES],
         ["eng", "exc", "lex", "str", "rel", "int", "foc"]),
        ("2.7.0", None, "MARKERS", VECTORS["dev_insight_1"]["cols"],
         VECTORS["met_13col_foc"]["cols"]),
        ("3.6.5", None, "MARKERS", VECTORS["dev_insight_1"]["cols"],
         VECTORS["met_13col_attention_last"]["cols"]),
        ("4.8.32", None, "MARKERS", VECTORS["dev_insight_1"]["cols"],
         VECTORS["met_13col_attention_first"]["cols"]),
        ("4.8.32", Metrics.FOCUS, "MARKERS", VECTORS["dev_insight_1"]["cols"],
         VECTORS["met_13col_foc"]["cols"]),
    ],
)  # fmt: skip
async def test_columns_are_those_of_the_release(
    world: World, version: str, metrics: Metrics | None, eeg_last: str, dev: list[Any],
    met: list[str],
) -> None:  # fmt: skip
    with SteeredCortex(world, Circumstances(release=Release(version, metrics))) as cortex:
        recording = await record(cortex, 5, *STREAMS)
    assert recording.columns["eeg"][-1] == eeg_last
    assert recording.columns["dev"] == dev
    assert recording.columns["met"] == met
    assert recording.columns["pow"] == VECTORS["pow_insight_1"]["cols"]


@pytest.mark.parametrize(
    ("model", "vector"),
    [(INSIGHT_1, "mot_quaternion_1"), (INSIGHT_1_GYRO, "mot_gyro_old_insight")],
)
async def test_messages_are_built_like_the_vectors(world: World, model: Model, vector: str) -> None:
    with SteeredCortex(world, model=model) as cortex:
        recording = await record(cortex, 5, *STREAMS, "eq")
    vectors = {
        "eeg": "eeg_insight_1",
        "mot": vector,
        "pow": "pow_insight_1",
        "dev": "dev_insight_1",
        "met": "met_13col_attention_first",
        "eq": "eq_insight_1",
    }
    for stream, name in vectors.items():
        assert recording.columns[stream] == VECTORS[name]["cols"]
        message, known = recording.client.data[stream][0], VECTORS[name]["message"]
        assert message.keys() == known.keys()
        for value, example in zip(message[stream], known[stream], strict=True):
            assert isinstance(value, list) == isinstance(example, list)
            assert isinstance(value, bool) == isinstance(example, bool)
