"""An agent, the page's program and web sites of other origins, for markers of web experiments."""

from __future__ import annotations

import functools
import json
import socket
import threading
from collections.abc import Callable
from http.client import HTTPConnection
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, NamedTuple

import pylsl

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.page.experiments.experiment_server import MARKERS, experiment_token
from tests.page.conftest import DEADLINE_S, Programs, Server
from tests.rigs.polling import wait_until

_SOURCE = naming.source_id(DeviceIdentity("gateway", socket.gethostname()), "markers")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return listening.getsockname()[1]


class _Quiet(SimpleHTTPRequestHandler):
    def log_request(self, code: object = "-", size: object = "-") -> None:
        pass


class Site:
    """A web server with the files of a folder, at an origin of its own."""

    def __init__(self, folder: Path) -> None:
        handler = functools.partial(_Quiet, directory=folder)
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        self.origin = f"http://127.0.0.1:{self._server.server_port}"

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class Answer(NamedTuple):
    """What a request got: code, headers, and the JSON or the text of it."""

    code: int
    headers: Any
    said: Any


class WebLab:
    """An agent without devices, the page's program, and a site that may mark."""

    def __init__(self, folder: Path) -> None:
        self.programs = Programs(folder)
        self.port = free_port()  # At which experiments are listened for.
        self.files = folder / "site"
        self.programs.settings.write_text("")
        self.programs.call("mark", "--web", "--save", str(self.files))
        self.site, self.other = Site(self.files), Site(self.files)
        self.origin = self.site.origin  # Of the site.
        self.allow(self.origin, "null")
        self.programs.start("run", "--no-ask")
        self.serve()

    @property
    def token(self) -> str:
        return experiment_token(self.programs.folder)

    @property
    def address(self) -> str:
        return f"ws://127.0.0.1:{self.port}"

    def serve(self) -> None:
        """Start the page's program, and let the experimenter in."""
        self.server = Server(self.programs)
        self.cookie = self.server.enter()
        wait_until(self.listens)

    def allow(self, *origins: str) -> None:
        """Write into the settings who may mark."""
        text = f"[markers.web]\nport = {self.port}\norigins = {json.dumps(origins)}\n"
        self.programs.settings.write_text(text)

    def listens(self) -> bool:
        try:
            socket.create_connection(("127.0.0.1", self.port), DEADLINE_S).close()
        except ConnectionRefusedError:
            return False
        return True

    @property
    def key(self) -> str:
        """What an experiment's address ends with."""
        return f"#gateway={self.token}&port={self.port}"

    def experiment(self, site: Site | None = None, token: str | None = None) -> str:
        """Return the address of the example, with all that it needs."""
        key = self.key if token is None else self.key.replace(self.token, token)
        return f"{(site or self.site).origin}/experiment.html{key}"

    def request(
        self, method: str, body: object = None, path: str = MARKERS, **headers: str
    ) -> Answer:
        """Send a request as no browser would; headers with ``_`` for ``-``, empty ones not."""
        usual = {
            "Origin": self.origin,
            "Authorization": f"Bearer {self.token}",
            "Content-Type": "application/json",
        }
        named = usual | {name.replace("_", "-"): value for name, value in headers.items()}
        sent = body if isinstance(body, bytes | None) else json.dumps(body).encode()
        connection = HTTPConnection("127.0.0.1", self.port, timeout=DEADLINE_S)
        connection.request(
            method, path, sent, {name: value for name, value in named.items() if value}
        )
        answer = connection.getresponse()
        said = answer.read().decode()
        connection.close()
        is_json = answer.headers.get("Content-Type") == "application/json"
        return Answer(answer.status, answer.headers, json.loads(said) if is_json else said)

    def close(self) -> None:
        self.site.close()
        self.other.close()
        self.programs.end()


class MarkerReader:
    """Receives the stream of markers."""

    def __init__(self) -> None:
        (found,) = pylsl.resolve_byprop("source_id", _SOURCE, timeout=DEADLINE_S)
        self._inlet = pylsl.StreamInlet(found, recover=False)
        self._inlet.open_stream(DEADLINE_S)
        self.markers: list[dict[str, Any]] = []
        wait_until(lambda: self._has(lambda each: True))

    def find(self, marker: str) -> dict[str, Any]:
        """Wait for a marker of this name; the first one."""
        wait_until(lambda: self._has(lambda each: each["marker"] == marker))
        return self.named(marker)[0]

    def wait_for(self, marker: str, note: str) -> None:
        """Wait for a marker with a note."""
        wait_until(
            lambda: self._has(lambda each: (each["marker"], each.get("note")) == (marker, note))
        )

    def named(self, marker: str) -> list[dict[str, Any]]:
        """Return those of this name that have come."""
        return [each for each in self.markers if each["marker"] == marker]

    def _has(self, fits: Callable[[dict[str, Any]], bool]) -> bool:
        samples, stamps = self._inlet.pull_chunk(timeout=0.0)
        for (text,), stamp in zip(samples, stamps, strict=True):
            self.markers.append({**json.loads(text), "stamp": stamp})
        return any(map(fits, self.markers))
