"""A plain socket client of the E4 server, and a driver under its supervisor."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from numpy.typing import NDArray

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.empatica_e4 import driver as driver_module
from biosensor_gateway.devices.empatica_e4.driver import DRIVER, E4Settings
from biosensor_gateway.simulation.truth import Truth
from biosensor_gateway.streaming import silence as silence_module
from tests.rigs.driver_run import NotedSink, Run, supervised

DEADLINE_S = 40.0
REGULAR = ("bvp", "acc", "gsr", "st")
MEASURED = (*REGULAR, "hr", "ibi", "bat")
Floats = NDArray[np.float64]


class LineClient:
    """Reads bytes as they come, with no knowledge of the product's parser."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.socket = socket.create_connection(
            (settings["host"], settings["port"]), timeout=DEADLINE_S
        )
        self._file = self.socket.makefile("rb")
        self.data: list[bytes] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self.socket.close()

    def send(self, request: str, end: str = "\r\n") -> None:
        self.socket.sendall((request + end).encode())

    def read(self) -> bytes:
        """Return the next line with its end; empty at the end of the connection."""
        line = self._file.readline()
        if line.startswith(b"E4_"):
            self.data.append(line)
        return line

    def reply(self) -> str:
        """Return the next line that is no data."""
        while (line := self.read()).startswith(b"E4_"):
            pass
        return line.decode()

    def ask(self, request: str, end: str = "\r\n") -> str:
        self.send(request, end)
        return self.reply()

    def begin(
        self, device_id: str = "9ff167", streams: str = "acc bvp gsr ibi tmp bat tag"
    ) -> None:
        """Bind and subscribe."""
        assert self.ask(f"device_connect {device_id}") == "R device_connect OK\n"
        for stream in streams.split():
            assert self.ask(f"device_subscribe {stream} ON") == f"R device_subscribe {stream} OK\n"


@pytest.fixture
def line_client() -> type[LineClient]:
    return LineClient


@pytest.fixture(scope="session")
def vectors() -> dict[str, Any]:
    """Return the protocol's vectors and scenarios."""
    path = Path(__file__).parent / "vectors" / "empatica_e4.json"
    loaded: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return loaded


class E4Run(Run):
    """The supervisor of a wristband behind the E4 server, and what came of it."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        sink = NotedSink("empatica_e4")
        named = {"sensor": "empatica_e4", "unit": sink.identity.unit}
        self._begin(sink, DRIVER.make(E4Settings.model_validate({**named, **settings}), sink))

    def has_reconnected(self) -> bool:
        return self.supervisor.connections > 1

    async def until(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, f"it did not happen; last error: {self.error}"
            await asyncio.sleep(0.02)

    async def until_more(self, *data_names: str, rows: int = 20) -> None:
        """Wait until so many more samples have come of some streams."""
        before = {name: len(self.sink.rows[name]) for name in data_names or ("bvp", "acc")}
        await self.until(
            lambda: all(len(self.sink.rows[name]) >= n + rows for name, n in before.items())
        )

    def places(self, truth: Truth, data_name: str = "bvp") -> list[int]:
        """Tell which of the true samples each emitted one is.

        Raises StopIteration for one that was not sent, that comes a second time, or not
        in its order; the noise makes every BVP unlike all others.
        """
        sent: list[list[float]] = truth.samples(data_name).values.tolist()
        emitted: list[list[float]] = self.sink.array(data_name).tolist()
        numbered = iter(enumerate(sent))
        return [next(number for number, row in numbered if row == each) for each in emitted]

    def assert_all_arrived(self, truth: Truth, *data_names: str) -> None:
        """What was sent is what was emitted, but for what is on its way."""
        for name in data_names or MEASURED:
            emitted, sent = self.sink.array(name), truth.samples(name).values
            assert 0 < len(emitted) <= len(sent), name
            np.testing.assert_allclose(emitted, sent[: len(emitted)], err_msg=name)

    def assert_none_doubled(self, truth: Truth) -> None:
        """Streams go on in order: no sample twice, nothing invented, all of it pushed."""
        numbers = self.places(truth)
        assert numbers == sorted(set(numbers))
        for name in MEASURED:
            assert len(self.sink.rows[name]) <= len(truth.samples(name).times), name
        for name in REGULAR:
            assert self.sink.counted(name).pushed == len(self.sink.rows[name])

    def stamp_errors(self, truth: Truth, data_name: str, after_s: float = 0.0) -> Floats:
        """Stamps against the time of measuring, where everything that was sent arrived."""
        times = truth.samples(data_name).times
        stamps = np.array(self.sink.times[data_name])
        errors = stamps - times[: len(stamps)]
        return errors[stamps > times[0] + after_s]


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten what a person would have to wait for."""
    for module, name, seconds in (
        (supervisor_module, "PROBE_INTERVAL_S", 0.1),
        (supervisor_module, "BACKOFF_FIRST_S", 0.1),
        (supervisor_module, "BACKOFF_CAP_S", 0.2),
        (driver_module, "PATIENCE_S", 2.5),
        # Skin conductance comes six samples at a time.
        (silence_module, "PATIENCE_SAMPLES", 10),
        (driver_module, "LIST_TIMEOUT_S", 1.5),
        (driver_module, "RADIO_GRACE_S", 2.0),
    ):
        monkeypatch.setattr(module, name, seconds)


Running = Callable[[Mapping[str, Any]], AbstractAsyncContextManager[E4Run]]


@pytest.fixture
def running(hasty: None) -> Running:
    """Run a driver until the block ends; then nothing may have been refused or be half closed."""
    del hasty

    @asynccontextmanager
    async def run_driver(settings: Mapping[str, Any]) -> AsyncGenerator[E4Run]:
        async with supervised(E4Run(settings)) as run:
            yield run

    return run_driver
