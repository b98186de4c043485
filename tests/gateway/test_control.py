"""The control channel: what is asked reaches the agent, and what came early is kept."""

from __future__ import annotations

import asyncio
import json
import os
import random
import socket
import stat
from collections.abc import AsyncGenerator, Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import structlog

from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.agent import control, control_server
from biosensor_gateway.agent.control import CONTROL_FILE, ask
from biosensor_gateway.agent.control_server import ControlServer
from biosensor_gateway.agent.single_instance import LOCK_FILE, single_instance
from biosensor_gateway.transports.link import Early
from tests.rigs.polling import until

# The control channel: what is asked reaches the agent, whatever else arrives is refused.

DEADLINE_S = 30.0
NO_AGENT = "no agent is running; start one with: biosensor-gateway run"


class Commands(dict[str, control_server.Command]):
    """Commands of every temper, and the arguments with which ``note`` was called."""

    def __init__(self) -> None:
        super().__init__(
            note=self._note, fail=self._fail, break_=self._break, hang=self._hang, odd=self._odd
        )
        self.noted: list[Mapping[str, Any]] = []

    async def _note(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        self.noted.append(arguments)
        return {"count": len(self.noted)}

    async def _fail(self, _arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        raise ConfigError(ConfigReason.NOT_FOUND, "no such device")

    async def _break(self, _arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        raise RuntimeError("a mistake")

    async def _hang(self, _arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        await asyncio.Event().wait()
        return {}

    async def _odd(self, _arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"no": {"JSON"}}


@pytest.fixture
def folder(tmp_path: Path) -> Generator[Path]:
    """A state folder that this process holds."""
    with single_instance(tmp_path):
        yield tmp_path


@pytest.fixture
def commands() -> Commands:
    return Commands()


@pytest.fixture
async def server(folder: Path, commands: Commands) -> AsyncGenerator[ControlServer]:
    async with ControlServer(folder, commands) as running:
        yield running


def place(folder: Path) -> dict[str, Any]:
    return json.loads((folder / CONTROL_FILE).read_text())


def names_in(folder: Path) -> set[str]:
    return {each.name for each in folder.iterdir()}


async def asked(folder: Path, command: str, arguments: Any = None) -> dict[str, Any]:
    return await asyncio.to_thread(ask, folder, command, arguments)


async def refusal(folder: Path, command: str) -> GatewayError:
    with pytest.raises(GatewayError) as caught:
        await asked(folder, command)
    return caught.value


@asynccontextmanager
async def connected(
    folder: Path,
) -> AsyncGenerator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection("127.0.0.1", place(folder)["port"])
    try:
        yield reader, writer
    finally:
        writer.close()
        await writer.wait_closed()


async def reply_to(folder: Path, sent: bytes, *, hang_up: bool = False) -> dict[str, Any]:
    """What comes back, which must be one line of JSON and the end."""
    async with connected(folder) as (reader, writer), asyncio.timeout(DEADLINE_S):
        writer.write(sent)
        if hang_up:
            writer.write_eof()
        # Who sends a lot may still be sending when the reply comes.
        line = await reader.read()
    assert line.count(b"\n") == 1
    assert line.endswith(b"\n")
    return json.loads(line)


def problem_in(reply: dict[str, Any]) -> str:
    assert reply.keys() == {"ok", "problem"}
    assert reply["ok"] is False
    return reply["problem"]


@pytest.mark.seam
async def test_what_is_asked_is_done_and_answered(
    server: ControlServer, folder: Path, commands: Commands
) -> None:
    arguments = {"device": "brustgurt ♥", "seconds": 1.5}
    assert await asked(folder, "note", arguments) == {"count": 1}
    assert await asked(folder, "note") == {"count": 2}
    assert commands.noted == [arguments, {}]


async def test_many_ask_at_once(server: ControlServer, folder: Path, commands: Commands) -> None:
    answers = await asyncio.gather(*(asked(folder, "note") for _ in range(8)))
    assert sorted(answer["count"] for answer in answers) == list(range(1, 9))


async def test_the_file_is_the_user_s_alone_and_goes_with_the_agent(
    folder: Path, commands: Commands
) -> None:
    tokens: set[str] = set()
    for _ in range(2):
        # As an agent leaves it that was killed at a bad moment.
        left = folder / f"{CONTROL_FILE}.{os.getpid()}"
        left.touch()
        left.chmod(0o666)
        async with ControlServer(folder, commands):
            assert names_in(folder) == {CONTROL_FILE, LOCK_FILE}
            assert stat.S_IMODE((folder / CONTROL_FILE).stat().st_mode) == 0o600
            tokens.add(place(folder)["token"])
        assert names_in(folder) == {LOCK_FILE}
    assert len(tokens) == 2
    assert all(len(bytes.fromhex(token)) == 32 for token in tokens)


async def test_only_this_computer_is_listened_to(server: ControlServer, folder: Path) -> None:
    port = place(folder)["port"]
    # Every address of 127.0.0.0/8 is this computer's, so a listener on all of them would answer.
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port), DEADLINE_S)
    socket.create_connection(("127.0.0.1", port), DEADLINE_S).close()


WRONG_TOKENS: list[Callable[[str], object]] = [
    lambda _right: "",
    lambda _right: "0" * 64,
    lambda right: right[:-1],
    lambda right: right + "0",
    lambda right: right.upper() + " ",
    lambda right: [right],
    lambda _right: None,
    lambda _right: 7,
    lambda _right: "\ud800",
    lambda _right: "♥",
]


@pytest.mark.parametrize("wrong", WRONG_TOKENS)
async def test_a_wrong_token_is_refused(
    server: ControlServer, folder: Path, commands: Commands, wrong: Callable[[str], object]
) -> None:
    right: str = place(folder)["token"]
    request = {"token": wrong(right), "command": "note"}
    told = problem_in(await reply_to(folder, json.dumps(request).encode() + b"\n"))
    assert "wrong token" in told
    assert right not in told
    assert commands.noted == []


async def test_without_a_token_one_does_not_even_learn_the_commands(
    server: ControlServer, folder: Path
) -> None:
    assert "wrong token" in problem_in(await reply_to(folder, b'{"command": "fly"}\n'))


NOISE = random.Random(1).randbytes(1000).replace(b"\n", b"") + b"\n"


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (NOISE, "not a JSON object"),
        (b"\n", "not a JSON object"),
        (b"[1, 2]\n", "not a JSON object"),
        (b"null\n", "not a JSON object"),
        (b'"\xff"\n', "not a JSON object"),
        ('{"token": ""}\n'.encode("utf-16"), "not a JSON object"),
        (b"[" * 4000 + b"\n", "not a JSON object"),
        (b'{"token": ' + b"9" * 4000 + b"}\n", "wrong token"),
        (b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", "not a JSON object"),
        (b" " * 8192 + b"\n", "not a JSON object"),
        (b" " * 8193 + b"\n", "longer than 8192 bytes"),
        (b"x" * 1_000_000 + b"\n", "longer than 8192 bytes"),
        (b"x" * 1_000_000, "longer than 8192 bytes"),
    ],
)
async def test_what_is_no_request_is_refused_with_a_sentence(
    server: ControlServer, folder: Path, commands: Commands, sent: bytes, words: str
) -> None:
    assert words in problem_in(await reply_to(folder, sent))
    assert await asked(folder, "note") == {"count": 1}


async def test_half_a_line_and_the_end_is_refused(server: ControlServer, folder: Path) -> None:
    told = problem_in(await reply_to(folder, b'{"token"', hang_up=True))
    assert told == "the line has no end"


async def test_half_a_line_and_silence_is_refused_and_disturbs_nobody(
    server: ControlServer, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_server, "TIME_LIMIT_S", 4.0)
    silent = asyncio.create_task(reply_to(folder, b'{"token"'))
    assert await asked(folder, "note") == {"count": 1}
    assert problem_in(await silent) == "no complete line came within 4 s"


@pytest.mark.parametrize("more", [{}, {"command": 7}, {"command": "fly"}, {"command": ["note"]}])
async def test_an_unknown_command_is_answered_with_the_known(
    server: ControlServer, folder: Path, more: dict[str, Any]
) -> None:
    request = {"token": place(folder)["token"], **more}
    told = problem_in(await reply_to(folder, json.dumps(request).encode() + b"\n"))
    assert told == "unknown command; known are: note, fail, break_, hang, odd"


async def test_arguments_are_an_object(
    server: ControlServer, folder: Path, commands: Commands
) -> None:
    request = {"token": place(folder)["token"], "command": "note", "arguments": [1]}
    told = problem_in(await reply_to(folder, json.dumps(request).encode() + b"\n"))
    assert told == "the arguments are not a JSON object"
    assert commands.noted == []


async def test_the_sentence_of_a_command_reaches_who_asked(
    server: ControlServer, folder: Path
) -> None:
    error = await refusal(folder, "fail")
    assert isinstance(error, ProtocolError)
    assert error.reason is ProtocolReason.REFUSED
    assert str(error) == "the agent refused fail: no such device"


@pytest.mark.parametrize("command", ["break_", "odd"])
async def test_a_command_with_a_mistake_costs_itself_only(
    server: ControlServer, folder: Path, command: str
) -> None:
    with structlog.testing.capture_logs() as logged:
        error = await refusal(folder, command)
    assert "the agent's log says why" in str(error)
    assert [entry["event"] for entry in logged] == ["a command came", "a command failed"]
    assert logged[1]["exc_info"] is True
    assert place(folder)["token"] not in str(logged)
    assert await asked(folder, "note") == {"count": 1}


async def test_a_command_that_hangs_is_given_up(
    server: ControlServer, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_server, "TIME_LIMIT_S", 1.0)
    with pytest.raises(ProtocolError, match="hang took longer than 1 s"):
        await asyncio.to_thread(ask, folder, "hang", time_limit_s=DEADLINE_S)


@pytest.mark.seam
@pytest.mark.parametrize(("command", "is_done"), [("note", False), ("pause", True)])
async def test_what_was_given_up_is_not_carried_out_later_but_for_a_pause(
    folder: Path, commands: Commands, command: str, is_done: bool
) -> None:
    known = {"note": commands["note"], "pause": commands["note"]}
    async with ControlServer(folder, known):
        with ThreadPoolExecutor() as asker:
            given_up = asker.submit(ask, folder, command, {}, 0.2)
            # The agent is busy for longer than its answer is waited for.
            with pytest.raises(TransportError):
                given_up.result()
        await until(lambda: len(commands.noted) == is_done)
        # It was told to try again.
        await asked(folder, command)
        assert len(commands.noted) == 1 + is_done


async def test_who_only_holds_connections_locks_nobody_out(
    server: ControlServer, folder: Path
) -> None:
    port = place(folder)["port"]
    idle = [
        await asyncio.open_connection("127.0.0.1", port)
        for _ in range(control_server.MAX_SILENT + 1)
    ]
    # The oldest made room; it is closed.
    assert await idle[0][0].read() == b""
    assert await asked(folder, "note") == {"count": 1}
    for _, writer in idle:
        writer.close()


async def test_only_so_many_programs_listen_at_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_server, "MAX_CONVERSATIONS", 1)

    async def feed(_arguments: Mapping[str, Any]) -> AsyncGenerator[bytes]:
        while True:
            yield b"news"
            await asyncio.sleep(1.0)

    async with ControlServer(folder, {}, {"feed": feed}):
        token = place(folder)["token"]
        reader, writer = await asyncio.open_connection("127.0.0.1", place(folder)["port"])
        writer.write(json.dumps({"token": token, "command": "feed"}).encode() + b"\n")
        assert await reader.readline() == b'{"ok": true, "answer": {}}\n'
        with pytest.raises(ProtocolError, match="too many programs are connected"):
            await asked(folder, "feed")
        writer.close()


async def test_who_asks_for_the_end_hears_of_it(folder: Path) -> None:
    ended = asyncio.Event()

    async def end(_arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        ended.set()
        return {"process": 1}

    async with ControlServer(folder, {"end": end}):
        answer = asyncio.create_task(asked(folder, "end"))
        await ended.wait()
    assert await answer == {"process": 1}


async def test_a_silent_client_does_not_hold_up_the_end(folder: Path, commands: Commands) -> None:
    server = ControlServer(folder, commands)
    await server.__aenter__()
    async with connected(folder) as (reader, writer), asyncio.timeout(DEADLINE_S):
        writer.write(b'{"token"')
        await asked(folder, "note")
        began = asyncio.get_running_loop().time()
        await server.__aexit__(None, None, None)
        # Well before the time limit of the connection.
        assert asyncio.get_running_loop().time() - began < control.TIME_LIMIT_S - 1
        assert await reader.read() == b""
    assert len(asyncio.all_tasks()) == 1


async def test_a_file_that_cannot_be_written_is_said(folder: Path, commands: Commands) -> None:
    (folder / CONTROL_FILE).mkdir()
    server = ControlServer(folder, commands)
    with pytest.raises(ConfigError, match="`stop` will not work") as caught:
        await server.__aenter__()
    assert caught.value.reason is ConfigReason.UNREADABLE
    assert str(folder / CONTROL_FILE) in str(caught.value)


def transport_error(folder: Path, time_limit_s: float = 1.0) -> TransportError:
    with pytest.raises(TransportError) as caught:
        ask(folder, "note", time_limit_s=time_limit_s)
    return caught.value


def test_without_an_agent_it_says_how_to_start_one(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "not there"):
        error = transport_error(folder)
        assert (error.reason, str(error)) == (TransportReason.ABSENT, NO_AGENT)
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_agent_left_is_no_agent(tmp_path: Path) -> None:
    # Another program has the port by now.
    with socket.create_server(("127.0.0.1", 0)) as other:
        (tmp_path / CONTROL_FILE).write_text(
            json.dumps({"port": other.getsockname()[1], "token": "0" * 64})
        )
        (tmp_path / LOCK_FILE).touch()
        error = transport_error(tmp_path)
        assert (error.reason, str(error)) == (TransportReason.ABSENT, NO_AGENT)
        other.setblocking(False)
        with pytest.raises(BlockingIOError):
            other.accept()


@pytest.mark.parametrize(
    "content",
    [
        None,
        "",
        "{",
        "[]",
        "7",
        "{}",
        '{"port": "x", "token": ""}',
        '{"port": 70000, "token": ""}',
        '{"port": 1e400, "token": ""}',
        '{"port": -1, "token": ""}',
        '{"port": null, "token": ""}',
        "\xff",
    ],
)
def test_an_agent_whose_file_is_not_there_or_damaged_does_not_answer(
    folder: Path, content: str | None
) -> None:
    if content is not None:
        (folder / CONTROL_FILE).write_bytes(content.encode("latin-1"))
    error = transport_error(folder)
    assert error.reason is TransportReason.SILENT
    assert str(folder) in str(error)


@pytest.mark.parametrize("is_listening", [True, False])
def test_an_agent_that_is_stuck_does_not_answer(folder: Path, is_listening: bool) -> None:
    with socket.socket() as stuck:
        stuck.bind(("127.0.0.1", 0))
        if is_listening:
            stuck.listen()
        token = "0123456789abcdef"
        content = json.dumps({"port": stuck.getsockname()[1], "token": token})
        (folder / CONTROL_FILE).write_text(content)
        error = transport_error(folder)
    assert error.reason is TransportReason.SILENT
    assert token not in str(error)


# What came early is kept in order up to a limit, and given out once.
def test_it_is_taken_once_and_in_order() -> None:
    early = Early[str](9)
    assert not early
    early.keep("a")
    early.keep("b", "c")
    assert early
    assert early.take() == ["a", "b", "c"]
    assert not early
    assert early.take() == []
    early.keep("d")
    assert early.take() == ["d"]


@pytest.mark.parametrize(("is_newest_kept", "kept"), [(False, [1, 2, 3]), (True, [3, 4, 5])])
@pytest.mark.parametrize("together", [True, False])
def test_there_is_room_for_so_many(is_newest_kept: bool, kept: list[int], together: bool) -> None:
    early = Early[int](3, is_newest_kept=is_newest_kept)
    for part in [(1, 2, 3, 4, 5)] if together else [(1, 2), (3, 4), (5,)]:
        early.keep(*part)
    assert early.take() == kept
    early.keep(6)
    assert early.take() == [6]
