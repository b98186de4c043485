"""Client of the Cortex service: requests, warnings and data."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Generator, Mapping
from typing import NamedTuple, TypeVar

import structlog

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.emotiv_insight.driver.messages import (
    Data,
    ErrorKind,
    Event,
    Fault,
    FaultCode,
    Reply,
    RpcError,
    Warned,
    parse,
)
from biosensor_gateway.settings.secrets import Secret
from biosensor_gateway.transports.link import ReceivedText, TextLink

_T = TypeVar("_T")


async def until(
    ask: Callable[[Warned | None], Awaitable[_T | None]],
    heard: asyncio.Queue[Warned],
    *,
    every_s: float,
    patience_s: float,
) -> _T | None:
    """Poll until there is a result: now, at each warning, and regularly.

    Parameters
    ----------
    ask
        Returns None for "not yet"; called with the warning, if there is one.
    heard
        Warnings that may announce the result.
    every_s
        Polling interval, because a warning may have been missed.
    patience_s
        Time limit, after which None is returned.
    """
    loop = asyncio.get_running_loop()
    deadline = loop.time() + patience_s
    warned: Warned | None = None
    while True:
        answer = await ask(warned)
        left = deadline - loop.time()
        if answer is not None or left <= 0:
            return answer
        try:
            async with asyncio.timeout(min(every_s, left)):
                warned = await heard.get()
        except TimeoutError:
            warned = None


REPLY_TIMEOUT_S = 10.0
KEPT_SAMPLES = 2048
"""About ten seconds of all streams, longer than a reply to ``subscribe`` may take."""

_log = structlog.get_logger("biosensor_gateway.emotiv_insight")


def request_text(request_id: int, method: str, params: Mapping[str, object] | None) -> str:
    """Return a JSON-RPC 2.0 request.

    Parameters
    ----------
    params
        JSON values and secrets; secrets are only revealed here, so that no traceback with
        variables shows them.
    """
    return json.dumps(
        {"jsonrpc": "2.0", "id": request_id, "method": method, "params": dict(params or {})},
        separators=(",", ":"),
        default=_revealed,
    )


def _revealed(value: object) -> str:
    if not isinstance(value, Secret):
        raise TypeError(f"{type(value).__name__} cannot be sent in a request")
    return value.reveal()


KEPT_WARNINGS = 64
_LOGGED_UNKNOWN = 8
_LONGEST_SHOWN = 200


class Warnings:
    """Distributes the warnings of one connection to the log and to waiting tasks."""

    def __init__(self) -> None:
        self._watches: list[tuple[frozenset[Event], asyncio.Queue[Warned]]] = []
        self._hidden: set[str] = set()
        self._unknown_codes: set[int] = set()

    def hide(self, text: str) -> None:
        """Hide a secret in errors and logs, in case Cortex quotes it."""
        if text:
            self._hidden.add(text)

    def watch(self, *events: Event) -> asyncio.Queue[Warned]:
        """Return a queue for future warnings of these kinds."""
        queue: asyncio.Queue[Warned] = asyncio.Queue()
        self._watches.append((frozenset(events), queue))
        return queue

    @contextlib.contextmanager
    def watching(self, *events: Event) -> Generator[asyncio.Queue[Warned]]:
        """Like `watch`, while the context is open."""
        queue = self.watch(*events)
        try:
            yield queue
        finally:
            self._watches = [each for each in self._watches if each[1] is not queue]

    def tell(self, warned: Warned) -> None:
        """Log a warning, and put it into the queues for its kind."""
        self._log_warning(warned)
        for events, queue in self._watches:
            if warned.event in events and queue.qsize() < KEPT_WARNINGS:
                queue.put_nowait(warned)

    def _log_warning(self, warned: Warned) -> None:
        if warned.event is Event.UNKNOWN:
            # Unknown warnings must not flood the log.
            if warned.code in self._unknown_codes or len(self._unknown_codes) >= _LOGGED_UNKNOWN:
                return
            self._unknown_codes.add(warned.code)
        text = self.shown(warned.text)
        people = f"the Emotiv program says: {text or warned.event.value}"
        _log.info(
            "Cortex tells",
            event_name=warned.event.value,
            code=warned.code,
            text=text,
            for_people=people,
        )

    def shown(self, text: str) -> str:
        """Return a text from Cortex without secrets, in one line of limited length."""
        for hidden in self._hidden:
            text = text.replace(hidden, "***")
        return " ".join(text.split())[:_LONGEST_SHOWN]


class ArrivedData(NamedTuple):
    """A sample, the LSL time at which it arrived, and the length of its message."""

    data: Data
    arrival: float
    size: int = 0


class CortexError(ProtocolError):
    """Cortex refused a request."""

    def __init__(self, method: str, error: RpcError) -> None:
        super().__init__(
            ProtocolReason.REFUSED, f"Cortex refuses {method}: {error.text} ({error.code})"
        )
        self.code = error.code
        self.kind: ErrorKind = error.kind  # How to handle it.


class CortexClient:
    """One connection to Cortex.

    Requests may run concurrently; replies are matched by id.
    """

    def __init__(self, link: TextLink) -> None:
        self._link = link
        self.warnings = Warnings()
        self._ids = itertools.count(1)
        self._pending: dict[int, asyncio.Future[Reply]] = {}
        self._unawaited: set[int] = set()
        self._data: deque[ArrivedData] = deque()
        self._news = asyncio.Event()
        self._reader: asyncio.Task[None] | None = None
        self._ended: TransportError | None = None
        self.faults: Counter[FaultCode] = Counter()  # Number of unusable messages by fault.
        self.dropped_bytes = 0  # Total length of unusable messages [characters].
        self._dropped_samples = 0

    @property
    def dropped_messages(self) -> int:
        """Number of messages dropped because they were not processed in time."""
        return self._link.dropped + self._dropped_samples

    async def open(self) -> None:
        """Connect; see the transport for its errors."""
        await self._link.open()
        self._reader = asyncio.create_task(self._read_forever())

    async def close(self) -> None:
        """Close the connection, which fails waiting requests; never raises."""
        await self._link.close()
        if self._reader is not None:
            self._reader.cancel()
            await asyncio.wait({self._reader})

    async def call(
        self, method: str, params: Mapping[str, object] | None = None, timeout_s: float = 0.0
    ) -> object:
        """Send a request and return the result.

        Parameters
        ----------
        params
            JSON values and secrets.
        timeout_s
            Time limit for the reply; 0 for the default.

        Raises
        ------
        CortexError
            If Cortex refuses.
        ProtocolError
            ``NO_REPLY``.
        TransportError
            ``LOST``.
        """
        reply_id = next(self._ids)
        future: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._pending[reply_id] = future
        try:
            if self._ended is not None:
                raise self._ended
            async with asyncio.timeout(timeout_s or REPLY_TIMEOUT_S):
                await self._link.send(request_text(reply_id, method, params))
                reply = await future
        except TimeoutError as error:
            message = f"Cortex does not answer {method}; restart EMOTIV Launcher"
            raise ProtocolError(ProtocolReason.NO_REPLY, message) from error
        finally:
            self._pending.pop(reply_id, None)
            # Retrieve an error that arrived together with the timeout, or asyncio logs it.
            if future.done() and not future.cancelled():
                future.exception()
        if reply.error is not None:
            shown = RpcError(reply.error.code, self.warnings.shown(reply.error.text))
            raise CortexError(method, shown)
        return reply.result

    async def send(self, method: str, params: Mapping[str, object]) -> None:
        """Send a request without waiting for the reply.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        reply_id = next(self._ids)
        self._unawaited.add(reply_id)
        await self._link.send(request_text(reply_id, method, params))

    async def next_data(self) -> ArrivedData:
        """Wait for the next sample of any stream.

        Raises
        ------
        TransportError
            ``LOST``, after everything received was returned.
        """
        while not self._data:
            if self._ended is not None:
                raise self._ended
            self._news.clear()
            await self._news.wait()
        return self._data.popleft()

    async def _read_forever(self) -> None:
        try:
            while True:
                self._take(await self._link.read())
        except TransportError as error:
            self._end(error)
        finally:
            self._end(TransportError(TransportReason.LOST, "the connection to Cortex is closed"))

    def _end(self, error: TransportError) -> None:
        if self._ended is None:
            self._ended = error
        for future in self._pending.values():
            if not future.done():
                future.set_exception(error)
        self._news.set()

    def _take(self, received: ReceivedText) -> None:
        match parse(received.text):
            case Data() as data:
                self._keep(ArrivedData(data, received.arrival, len(received.text)))
            case Reply() as reply:
                self._answer(reply)
            case Warned() as warned:
                self.warnings.tell(warned)
            case Fault() as fault:
                self.dropped_bytes += len(received.text)
                self.note(fault)

    def note(self, fault: Fault) -> None:
        """Count an unusable message, and log the first of its kind."""
        self.faults[fault.code] += 1
        if self.faults[fault.code] == 1:
            _log.warning("a message from Cortex cannot be used", cause=fault.code.value)

    def _keep(self, arrived: ArrivedData) -> None:
        self._data.append(arrived)
        if len(self._data) > KEPT_SAMPLES:
            self._data.popleft()
            self._dropped_samples += 1
        self._news.set()

    def _answer(self, reply: Reply) -> None:
        if reply.attention is not None:
            self.warnings.tell(reply.attention)
        if reply.request_id in self._unawaited:
            self._unawaited.discard(reply.request_id)
            return
        future = self._pending.get(reply.request_id)
        if future is None or future.done():
            self.note(Fault(FaultCode.UNKNOWN_ID))
        else:
            future.set_result(reply)
