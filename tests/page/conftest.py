"""The page's server and the agent as real programs, and a real Chromium that looks at them."""

from __future__ import annotations

import json
import os
import queue
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Generator
from contextlib import ExitStack, suppress
from email.message import Message
from http.client import HTTPConnection
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from playwright.sync_api import Browser, BrowserContext, Page

from biosensor_common.errors import GatewayError
from biosensor_gateway.agent.control import stop_agent
from tests.rigs import file_keyring
from tests.rigs.chromium import chromium
from tests.rigs.processes import OF_A_FOLDER, end_all, outliving

DEADLINE_S = 60.0
STARTED = re.compile(r"http://127\.0\.0\.1:(\d+)/door\?token=\S+")


class Programs:
    """Runs our programs with a state folder and a settings file of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder  # The state folder.
        self.settings = folder / "settings.toml"  # The settings file, which need not exist.
        self.keyring = folder / "keyring.json"  # The file that is the system's keyring.
        self.variables: dict[str, str] = {}
        # Variables that a test needs beside the usual ones.
        self.environment_more: dict[str, str] = {}
        self._running: list[subprocess.Popen[bytes]] = []

    def start(self, *arguments: str, stdout: int = subprocess.DEVNULL) -> subprocess.Popen[bytes]:
        """Start one; it is ended with the test."""
        command = [sys.executable, "-m", "biosensor_gateway.cli", *arguments]
        errors = (self.folder / f"stderr-{len(self._running)}.txt").open("wb")
        with errors:
            process = subprocess.Popen(command, env=self.environment, stderr=errors, stdout=stdout)
        self._running.append(process)
        return process

    def call(self, *arguments: str) -> str:
        """Run one to its end; its output."""
        command = [sys.executable, "-m", "biosensor_gateway.cli", *arguments]
        done = subprocess.run(command, env=self.environment, capture_output=True, check=True)
        return done.stdout.decode()

    @property
    def environment(self) -> dict[str, str]:
        return os.environ | {
            "BIOSENSOR_GATEWAY_STATE": str(self.folder),
            "BIOSENSOR_GATEWAY_SETTINGS": str(self.settings),
            **file_keyring.environment(self.keyring),
            **self.environment_more,
            **self.variables,
        }

    def end(self) -> None:
        """End all of them, and then an agent that the page has started."""
        for process in self._running:
            process.terminate()
        for process in self._running:
            process.wait(DEADLINE_S)
            if process.stdout is not None:
                process.stdout.close()
        # A page that ends in the midst of a capture gives the agent its device back: it starts it.
        # From here, because a program that only asks takes longer to start than most tests.
        with suppress(GatewayError):
            stop_agent(self.folder)
        # One that is about to start has no lock yet by which it could be asked.
        end_all(outliving(OF_A_FOLDER, self.folder), grace_s=0.0)


class Answer(NamedTuple):
    """What a server has answered."""

    status: int
    headers: Message
    body: bytes


def assert_listens_on_loopback_alone(process: subprocess.Popen[bytes], port: int) -> None:
    """At this port, by what the system says of the process."""
    listening = [
        line.split()[1]
        for name in ("tcp", "tcp6")
        for line in Path(f"/proc/{process.pid}/net/{name}").read_text().splitlines()[1:]
        if line.split()[3] == "0A" and line.split()[1].endswith(f":{port:04X}")
    ]
    assert listening == [f"0100007F:{port:04X}"]


class Server:
    """The page's server: where it is, and the way in; options for its command can be given."""

    def __init__(self, programs: Programs, *options: str) -> None:
        self.programs = programs
        self.process = programs.start("page", "--no-open", *options, stdout=subprocess.PIPE)
        self._said: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()
        found = self.said(STARTED)
        self.address = found[0]
        self.port = int(found[1])

    def said(self, pattern: re.Pattern[str]) -> re.Match[str]:
        """Wait for a line that it prints."""
        while (found := pattern.search(self._said.get(timeout=DEADLINE_S))) is None:
            pass
        return found

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._said.put(line.decode())

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def enter(self) -> str:
        """Take the way in, which is there once; the cookie."""
        answer = self.request("GET", self.address.removeprefix(self.origin), cookie="")
        return answer.headers["Set-Cookie"].partition(";")[0]

    def request(
        self,
        method: str,
        path: str,
        cookie: str,
        body: bytes | None = None,
        **headers: str,
    ) -> Answer:
        """Send a request as no browser would; headers with ``_`` for ``-``."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=DEADLINE_S)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        if cookie:
            named["Cookie"] = cookie
        connection.request(method, path, body, named)
        got = connection.getresponse()
        answer = Answer(got.status, got.headers, got.read())
        connection.close()
        return answer

    def tell(self, method: str, path: str, cookie: str, content: object) -> Answer:
        """Send what the page itself would."""
        body = json.dumps(content).encode()
        headers = {"Origin": self.origin, "Content_Type": "application/json"}
        return self.request(method, f"/api/v1/{path}", cookie, body, **headers)


@pytest.fixture
def programs(tmp_path: Path) -> Generator[Programs]:
    running = Programs(tmp_path)
    yield running
    running.end()


@pytest.fixture
def server(programs: Programs) -> Server:
    return Server(programs)


@pytest.fixture(scope="module", name="chromium")
def running_chromium() -> Generator[Browser]:
    # Not longer: no test in its thread can have an event loop meanwhile.
    with chromium() as browser:
        yield browser


@pytest.fixture
def window(chromium: Browser) -> Generator[Callable[..., Page]]:
    """Open a window of a size; whatever goes wrong in its scripts fails the test."""
    with ExitStack() as stack:
        errors: list[str] = []

        def opened(**options: Any) -> Page:
            context: BrowserContext = chromium.new_context(**options)
            stack.callback(context.close)
            page = context.new_page()
            page.set_default_timeout(1000 * DEADLINE_S)
            page.on("pageerror", lambda error: errors.append(str(error)))
            return page

        yield opened
    assert not errors
