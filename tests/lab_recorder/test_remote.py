"""The conversation with LabRecorder, on real sockets."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Generator
from pathlib import Path

import pytest

from biosensor_gateway.recording.recorder.labrecorder import RemoteControl
from biosensor_gateway.recording.recorder.request import RecorderError, RecorderReason
from tests.lab_recorder.remote_control import LabRecorderPeer

LOCAL = "127.0.0.1"
DEADLINE_S = 30.0

Serve = Callable[[Callable[[socket.socket], None]], int]


@pytest.fixture
def serve() -> Generator[Serve]:
    """Have one client served; returns the port."""
    threads: list[threading.Thread] = []

    def begin(conversation: Callable[[socket.socket], None]) -> int:
        server = socket.create_server((LOCAL, 0))

        def run() -> None:
            with server, server.accept()[0] as client:
                conversation(client)

        threads.append(threading.Thread(target=run))
        threads[0].start()
        return server.getsockname()[1]

    yield begin
    for thread in threads:
        thread.join(DEADLINE_S)
        assert not thread.is_alive()


def reason_of(port: int, line: str = "update", limit_s: float = DEADLINE_S) -> RecorderError:
    with RemoteControl(LOCAL, port) as remote, pytest.raises(RecorderError) as caught:
        remote.command(line, limit_s)
    return caught.value


@pytest.mark.seam
def test_each_command_waits_for_the_answer_to_the_one_before(recorder: LabRecorderPeer) -> None:
    with RemoteControl(LOCAL, recorder.port) as remote:
        for line in ("update", "select none", "gibberish", "filename {task:A}"):
            remote.command(line)
        assert remote.is_local
    assert recorder.lines == ["update", "select none", "gibberish", "filename {task:A}"]


def test_nobody_there_is_said_with_what_to_do() -> None:
    with socket.create_server((LOCAL, 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(RecorderError, match="EnableRCS") as caught, RemoteControl(LOCAL, port):
        pass
    assert caught.value.reason is RecorderReason.UNREACHABLE
    assert f"{LOCAL}:{port}" in str(caught.value)


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a" * 70, "a..b"])
def test_a_host_that_cannot_be_found_is_unreachable(host: str) -> None:
    with pytest.raises(RecorderError) as caught, RemoteControl(host, 22345):
        pass
    assert caught.value.reason is RecorderReason.UNREACHABLE


@pytest.mark.nightly
def test_a_message_box_is_suspected_behind_silence(tmp_path: Path) -> None:
    root = tmp_path / "a file, so no folder can be made"
    root.touch()
    with LabRecorderPeer(root) as recorder:
        error = reason_of(recorder.port, "start", 5.0)
        assert "Can not create the directory" in recorder.box
    assert error.reason is RecorderReason.NO_REPLY
    assert "window" in str(error)


@pytest.mark.nightly
def test_another_answer_is_no_labrecorder(serve: Serve) -> None:
    def greet(client: socket.socket) -> None:
        client.recv(100)
        client.sendall(b"220 mail.example ESMTP\r\n")
        client.recv(100)

    error = reason_of(serve(greet))
    assert error.reason is RecorderReason.REFUSED
    assert "220 mail" in str(error)


@pytest.mark.nightly
def test_an_end_of_the_connection_is_no_answer(serve: Serve) -> None:
    def hang_up(client: socket.socket) -> None:
        client.recv(100)

    error = reason_of(serve(hang_up))
    assert error.reason is RecorderReason.UNREACHABLE
    assert "went away at 'update'" in str(error)
