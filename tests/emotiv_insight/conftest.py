"""A scripted Cortex on a real WebSocket with TLS, and a driver under its supervisor."""

from __future__ import annotations

import asyncio
import contextlib
import json
import ssl
import uuid
from collections import deque
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import trustme
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.emotiv_insight import driver
from biosensor_gateway.devices.emotiv_insight.driver import (
    DRIVER,
    EmotivInsightSettings,
    account,
    session,
)
from tests.rigs.driver_run import NotedSink, Run, supervised

HEADSET_ID = "INSIGHT-12341234"
TOKEN, NEW_TOKEN = "planted.token.one", "planted.token.two"
CLIENT_ID, CLIENT_SECRET = "planted-client-id", "planted-client-secret"

EEG = ["COUNTER", "INTERPOLATED", "AF3", "T7", "Pz", "T8", "AF4", "RAW_CQ", "MARKER_HARDWARE",
       "MARKERS"]  # fmt: skip
MOTION = ["COUNTER_MEMS", "INTERPOLATED_MEMS", "Q0", "Q1", "Q2", "Q3", "ACCX", "ACCY", "ACCZ",
          "MAGX", "MAGY", "MAGZ"]  # fmt: skip
POWER = [f"{electrode}/{band}" for electrode in EEG[2:7]
         for band in ("theta", "alpha", "betaL", "betaH", "gamma")]  # fmt: skip
METRICS = ["attention.isActive", "attention", "eng.isActive", "eng", "lex"]
DEVICE = ["Battery", "Signal", [*EEG[2:7], "OVERALL"], "BatteryPercent"]

Answer = Callable[["ScriptedCortex", ServerConnection, dict[str, Any]], Awaitable[None]]


class Request(NamedTuple):
    method: str
    params: dict[str, Any]


class ScriptedCortex:
    """Answers like Cortex on a good day, and as it was told for single requests."""

    def __init__(self, context: ssl.SSLContext, ca_file: Path) -> None:
        self._context, self.ca_file = context, ca_file
        self._script: dict[str, deque[Answer]] = {}
        self._server: Server | None = None
        self.port = 0
        self.requests: list[Request] = []
        self.opened = 0
        self.tokens = iter([TOKEN, NEW_TOKEN, *(f"planted.token.{n}" for n in range(3, 999))])
        self.headsets: list[dict[str, Any]] = [self.headset()]
        self.columns: dict[str, list[Any]] = {
            "eeg": EEG, "mot": MOTION, "pow": POWER, "met": METRICS, "dev": DEVICE
        }  # fmt: skip
        self.failures: dict[str, int] = {}
        self.session = ""

    @property
    def url(self) -> str:
        return f"wss://localhost:{self.port}"

    @property
    def settings(self) -> dict[str, str]:
        return {"url": self.url, "ca_file": str(self.ca_file)}

    @property
    def methods(self) -> list[str]:
        return [request.method for request in self.requests]

    def count(self, method: str) -> int:
        return self.methods.count(method)

    @staticmethod
    def headset(status: str = "connected", **settings: Any) -> dict[str, Any]:
        rates = {"eegRate": 128, "memsRate": 64} if status == "connected" else {}
        return {"id": HEADSET_ID, "status": status, "firmware": "a11", "customName": "blue",
                "settings": {**rates, **settings}, "isVirtual": False}  # fmt: skip

    async def start(self) -> None:
        self._server = await serve(
            self._serve, "localhost", self.port, ssl=self._context, ping_interval=None
        )
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self, code: int = 1001) -> None:
        if self._server is not None:
            self._server.close(code=code)
            await self._server.wait_closed()

    def on(self, method: str, *answers: Answer) -> None:
        """Answer the next requests in this way, the later ones as usual."""
        self._script.setdefault(method, deque()).extend(answers)

    async def say(self, *messages: object) -> None:
        """Send to everybody: text and bytes as they are, all else as JSON."""
        assert self._server is not None
        for socket in list(self._server.connections):
            for message in messages:
                text = message if isinstance(message, str | bytes) else json.dumps(message)
                with contextlib.suppress(ConnectionClosed):
                    await socket.send(text)

    async def warn(self, code: int, message: Any = "text") -> None:
        await self.say({"jsonrpc": "2.0", "warning": {"code": code, "message": message}})

    async def each_connection(self, act: Callable[[ServerConnection], Any]) -> None:
        assert self._server is not None
        for socket in list(self._server.connections):
            outcome = act(socket)
            if asyncio.iscoroutine(outcome):
                await outcome

    def data(self, stream: str, values: Sequence[Any], time_s: float) -> dict[str, Any]:
        return {stream: list(values), "sid": self.session, "time": round(time_s, 4)}

    def eeg(self, number: int, time_s: float, *, interpolated: int = 0) -> dict[str, Any]:
        """Make sample ``number`` of a second that begins at some time; its value tells it apart."""
        values: list[Any] = [number % 128, interpolated, *[4200.0 + number] * 5, 0.0, 0, []]
        return self.data("eeg", values, time_s + number / 128)

    async def _serve(self, socket: ServerConnection) -> None:
        self.opened += 1
        with contextlib.suppress(ConnectionClosed):
            async for text in socket:
                request = json.loads(text)
                self.requests.append(Request(request["method"], request["params"]))
                script = self._script.get(request["method"])
                # The client leaves without waiting for its last replies.
                with contextlib.suppress(ConnectionClosed):
                    await (script.popleft() if script else usual)(self, socket, request)

    def result(self, method: str, params: dict[str, Any]) -> Any:
        fixed = {
            "getCortexInfo": {"version": "4.8.32", "buildNumber": "v4.8.32"},
            "getUserLogin": [{"username": "u", "currentOSUId": "1", "loggedInOSUId": "1"}],
            "hasAccessRight": {"accessGranted": True, "message": "granted"},
            "queryHeadsets": self.headsets,
        }
        made = {
            "authorize": lambda: {"cortexToken": next(self.tokens)},
            "createSession": lambda: self._new_session(params["status"]),
            "subscribe": lambda: self._subscription(params["streams"]),
        }
        return made[method]() if method in made else fixed.get(method, {})

    def _new_session(self, status: str) -> dict[str, Any]:
        self.session = str(uuid.uuid4())
        status = {"active": "activated", "open": "opened"}[status]
        return {"id": self.session, "status": status, "headset": self.headsets[0]}

    def _subscription(self, streams: list[str]) -> dict[str, Any]:
        success = [{"streamName": each, "cols": self.columns[each], "sid": self.session}
                   for each in streams if each in self.columns.keys() - self.failures]  # fmt: skip
        failure = [{"streamName": each, "code": code, "message": "no"}
                   for each, code in self.failures.items() if each in streams]  # fmt: skip
        return {"success": success, "failure": failure}


async def usual(cortex: ScriptedCortex, socket: ServerConnection, request: dict[str, Any]) -> None:
    result = cortex.result(request["method"], request["params"])
    await socket.send(json.dumps({"jsonrpc": "2.0", "id": request["id"], "result": result}))


class Answers:
    """Ways to answer a request."""

    usual: Answer = staticmethod(usual)

    @staticmethod
    def result(result: Any, **beside: Any) -> Answer:
        async def answer(_: ScriptedCortex, socket: ServerConnection, request: Any) -> None:
            await socket.send(json.dumps({"id": request["id"], "result": result, **beside}))

        return answer

    @staticmethod
    def error(code: int, text: str = "text") -> Answer:
        async def answer(_: ScriptedCortex, socket: ServerConnection, request: Any) -> None:
            error = {"code": code, "message": text}
            await socket.send(json.dumps({"id": request["id"], "error": error}))

        return answer

    @staticmethod
    def quoting(code: int) -> Answer:
        """Refuse, and repeat all that the request says."""

        async def answer(_: ScriptedCortex, socket: ServerConnection, request: Any) -> None:
            error = {"code": code, "message": f"\n{'x' * 150}{json.dumps(request['params'])}"}
            await socket.send(json.dumps({"id": request["id"], "error": error}))

        return answer

    @staticmethod
    async def nothing(_: ScriptedCortex, __: ServerConnection, ___: Any) -> None:
        """Leave the request without a reply."""


class InsightRun(Run):
    """The supervisor of a headset behind Cortex, and what came of it."""

    def __init__(self, **settings: Any) -> None:
        sink = NotedSink("emotiv_insight")
        named = {"sensor": "emotiv_insight", "unit": sink.identity.unit}
        self.settings = EmotivInsightSettings.model_validate({**named, **settings})
        self._begin(sink, DRIVER.make(self.settings, sink))


@pytest.fixture(scope="session")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture
async def cortex(authority: trustme.CA, tmp_path: Path) -> AsyncGenerator[ScriptedCortex]:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    with authority.issue_cert("localhost").private_key_and_cert_chain_pem.tempfile() as identity:
        context.load_cert_chain(identity)
    ca_file = tmp_path / "ca.pem"
    authority.cert_pem.write_to_path(ca_file)
    started = ScriptedCortex(context, ca_file)
    await started.start()
    yield started
    # One that reads nothing any more would not notice that it is closed.
    await started.each_connection(lambda socket: socket.transport.abort())
    await started.stop()


@pytest.fixture
def credentials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EMOTIV_CLIENT_ID", CLIENT_ID)
    monkeypatch.setenv("EMOTIV_CLIENT_SECRET", CLIENT_SECRET)


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten what a person would have to wait for."""
    for module, name, seconds in (
        (supervisor_module, "PROBE_INTERVAL_S", 0.05),
        (supervisor_module, "BACKOFF_FIRST_S", 0.05),
        (account, "ASK_EVERY_S", 0.1),
        (account, "RETRY_HEADSET_S", 0.05),
        (session, "ASK_EVERY_S", 0.1),
        (session, "SCAN_PATIENCE_S", 2.0),
        (driver, "PATIENCE_S", 1.5),
    ):
        monkeypatch.setattr(module, name, seconds)


@pytest.fixture
def answers() -> type[Answers]:
    return Answers


@pytest.fixture
def make_run() -> type[InsightRun]:
    return InsightRun


Running = Callable[..., contextlib.AbstractAsyncContextManager[InsightRun]]


@pytest.fixture
def running(cortex: ScriptedCortex, credentials: None, hasty: None) -> Running:
    """Run a driver until the block ends; then nothing may have been refused or be left open."""

    @contextlib.asynccontextmanager
    async def run(**settings: Any) -> AsyncGenerator[InsightRun]:
        async with supervised(InsightRun(**{**cortex.settings, **settings})) as made:
            yield made

    return run


@pytest.fixture
def planted() -> tuple[str, ...]:
    """All texts that must not be seen anywhere."""
    return (CLIENT_ID, CLIENT_SECRET, TOKEN, NEW_TOKEN, "planted")
