"""Server of the control channel: receives the same user's commands for the running agent.

The protocol is described in `control`.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import secrets
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Container, Mapping
from pathlib import Path
from typing import Any, Self, cast

import structlog

from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_gateway.agent.control import (
    CONTROL_FILE,
    HOST,
    TIME_LIMIT_S,
    json_object,
    line,
)
from biosensor_gateway.system import state_file

REQUEST_LIMIT = 8192
"""Bytes of a request without its line end: room for two texts of 200 letters at 12 bytes."""
MAX_SILENT = 16
"""Connections that have not sent the token yet; one more closes the oldest."""
MAX_CONVERSATIONS = 16
DONE_LATE = frozenset({"pause", "stop"})
"""Commands that are carried out even if whoever asked has given up: they only ever end what is sent
of a participant. Anything else would be done twice, because the asker was told to try again."""

_DISCARDED_BLOCK, _DISCARDED_BLOCKS = 65536, 256
_LAST_WORDS_S = 0.5

Command = Callable[[Mapping[str, Any]], Awaitable[Mapping[str, Any]]]
"""Carries out a command with its arguments, and returns the answer for JSON.

The message of a `GatewayError` is sent to the client.
"""

Conversation = Callable[[Mapping[str, Any]], AsyncGenerator[bytes]]
"""Yields the bytes that follow the line of the answer, until the client disconnects.

The message of a `GatewayError` before the first bytes is sent to the client.
"""

_log = structlog.stdlib.get_logger(__name__)


class ControlServer:
    """Listens for commands while the context lasts.

    Parameters
    ----------
    folder
        The state folder, locked by this process.
    conversations
        Commands by name whose answer goes on until the client disconnects.
    looks
        Names of commands that change nothing; the log has them only in its details.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` on entering, if there is no port or the file cannot be
        written; the agent can run without it.
    """

    def __init__(
        self,
        folder: Path,
        commands: Mapping[str, Command],
        conversations: Mapping[str, Conversation] | None = None,
        looks: Container[str] = (),
    ) -> None:
        self._path = folder / CONTROL_FILE
        self._commands = commands
        self._conversations = dict(conversations or {})
        self._looks = looks
        self._token = secrets.token_hex(32)
        self._connections: set[asyncio.Task[None]] = set()
        # A dict as an ordered set: the oldest connection is the first.
        self._silent: dict[asyncio.Task[None], None] = {}
        self._endless: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        try:
            self._server = await asyncio.start_server(self._connected, HOST, 0, limit=REQUEST_LIMIT)
            with contextlib.ExitStack() as failed:
                failed.callback(self._server.close)
                port: int = self._server.sockets[0].getsockname()[1]
                entry = json.dumps({"port": port, "token": self._token})
                state_file.replace(self._path, entry, private=True)
                failed.pop_all()
        except OSError as error:
            message = f"{self._path}: {error.strerror or error}; `stop` will not work"
            raise ConfigError(ConfigReason.UNREADABLE, message) from error
        return self

    async def __aexit__(self, *_problem: object) -> None:
        with contextlib.suppress(OSError):
            self._path.unlink()
        self._server.close()
        for conversation in self._endless:
            conversation.cancel()
        if not self._connections:
            return
        # A client that has asked the agent to end still gets its answer.
        _, late = await asyncio.wait(self._connections, timeout=_LAST_WORDS_S)
        for connection in late:
            connection.cancel()
        await asyncio.gather(*late, return_exceptions=True)

    def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._silent) >= MAX_SILENT:
            # Programs that connect and send nothing must not keep a user from ending the agent.
            oldest = next(iter(self._silent))
            del self._silent[oldest]
            oldest.cancel()
        connection = asyncio.create_task(self._converse(reader, writer))
        self._connections.add(connection)
        self._silent[connection] = None
        connection.add_done_callback(self._ended)

    def _ended(self, connection: asyncio.Task[None]) -> None:
        self._connections.discard(connection)
        self._silent.pop(connection, None)

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            reply, conversation = await self._reply(reader)
            writer.write(reply)
            if conversation is not None:
                await self._go_on(conversation, writer)
            async with asyncio.timeout(TIME_LIMIT_S):
                await writer.drain()
                writer.write_eof()
                # Closing on unread input would reset the connection, and lose the reply.
                for _ in range(_DISCARDED_BLOCKS):
                    if not await reader.read(_DISCARDED_BLOCK):
                        break
        except (OSError, TimeoutError):
            # The client has disconnected, or does not read; it alone loses by it.
            pass
        finally:
            writer.transport.abort()

    async def _go_on(
        self, conversation: AsyncGenerator[bytes], writer: asyncio.StreamWriter
    ) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._endless.add(task)
        try:
            async with contextlib.aclosing(conversation):
                async for message in conversation:
                    writer.write(message)
                    await writer.drain()
        finally:
            self._endless.discard(task)

    async def _reply(
        self, reader: asyncio.StreamReader
    ) -> tuple[bytes, AsyncGenerator[bytes] | None]:
        """Return the line of the answer, and the conversation that follows it, if any."""
        try:
            name, arguments = self._checked(await _request(reader))
            if name in self._conversations:
                conversation = self._conversations[name](arguments)
                # The first bytes now, so that an error is still answered in a line.
                async with self._limited(name):
                    first = await anext(conversation)
                return line({"ok": True, "answer": {}}) + first, conversation
            async with self._limited(name):
                answer = await self._commands[name](arguments)
                return line({"ok": True, "answer": dict(answer)}), None
        except _RefusedError as refused:
            return _refusal(str(refused)), None

    def _checked(self, request: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
        if not self._is_token(request.get("token")):
            raise _RefusedError(f"wrong token; the right one is in {self._path}")
        task = asyncio.current_task()
        assert task is not None
        self._silent.pop(task, None)
        name, arguments = request.get("command"), request.get("arguments", {})
        known = [*self._commands, *self._conversations]
        if not isinstance(name, str) or name not in known:
            raise _RefusedError(f"unknown command; known are: {', '.join(known)}")
        until = request.get("until")
        is_late = isinstance(until, int | float) and time.monotonic() > until
        if is_late and name not in DONE_LATE:
            _log.warning("a command came too late, and is not carried out", command=name)
            raise _RefusedError(f"{name} came when it was given up, and is not carried out")
        if name in self._conversations and len(self._endless) >= MAX_CONVERSATIONS:
            raise _RefusedError("too many programs are connected; end one of them")
        if not isinstance(arguments, dict):
            raise _RefusedError("the arguments are not a JSON object")
        return name, cast("dict[str, Any]", arguments)

    def _is_token(self, given: object) -> bool:
        # JSON can contain halves of surrogate pairs, which strict UTF-8 cannot encode.
        text = given.encode(errors="replace") if isinstance(given, str) else b""
        return hmac.compare_digest(text, self._token.encode())

    @contextlib.asynccontextmanager
    async def _limited(self, name: str) -> AsyncGenerator[None]:
        """Limit a command's time, and turn its exceptions into refusals."""
        is_look = name in self._looks or name in self._conversations
        # Programs ask for these every second.
        log = _log.debug if is_look else _log.info
        log("a command came", command=name, for_people=f"asked to {name}")
        try:
            async with asyncio.timeout(TIME_LIMIT_S):
                yield
        except TimeoutError:
            raise _RefusedError(f"{name} took longer than {TIME_LIMIT_S:g} s") from None
        except GatewayError as error:
            raise _RefusedError(str(error)) from error
        except Exception as error:  # the client must get an answer in any case
            _log.exception("a command failed", command=name)
            raise _RefusedError(f"{name} failed; the agent's log says why") from error


class _RefusedError(Exception):
    """A request was refused; the message is the sentence for the client."""


async def _request(reader: asyncio.StreamReader) -> Mapping[str, Any]:
    try:
        async with asyncio.timeout(TIME_LIMIT_S):
            received = await reader.readuntil(b"\n")
    except TimeoutError:
        raise _RefusedError(f"no complete line came within {TIME_LIMIT_S:g} s") from None
    except asyncio.LimitOverrunError:
        raise _RefusedError(f"the line is longer than {REQUEST_LIMIT} bytes") from None
    except asyncio.IncompleteReadError:
        raise _RefusedError("the line has no end") from None
    request = json_object(received)
    if request is None:
        raise _RefusedError("the line is not a JSON object")
    return request


def _refusal(sentence: str) -> bytes:
    return line({"ok": False, "problem": sentence})
