# pyright: reportPrivateUsage=false
"""Each request of each driver, refused once or always, lost, or answered with garbage."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Generator
from contextlib import contextmanager
from enum import Enum
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from bumble.att import ATT_Error
from bumble.core import UUID

from biosensor_common.quantities import ChannelRole
from biosensor_gateway.agent import supervisor
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.simulation.central import GattLink, OnValue
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.link import ReceivedText
from biosensor_gateway.transports.threads import Traffic
from biosensor_gateway.transports.websocket import WebSocketLink
from tests.contracts.conftest import NAMES, ON_AIR, class_of, is_recording
from tests.contracts.test_any_driver import measured
from tests.contracts.test_untidy import STAMP_LIMIT_S, errors_by_place, errors_by_value
from tests.rigs.driver_run import Run, streaming
from tests.rigs.memory_links import MemorySerialLink, MemoryTcpLink
from tests.rigs.polling import until

if TYPE_CHECKING:
    from tests.contracts.conftest import Make

SECONDS, SETTLED_S, OF_NOW_S = 45.0, 30.0, 25.0
"""How long each driver has, from when on its stamps are right, and how old what comes may be."""
ATT_REFUSED = 0x80
"""The first code that an application may use for its own reasons."""
BATTERY_LEVEL = UUID.from_16_bits(0x2A19)


class Manner(Enum):
    """What becomes of one request."""

    ONCE = "refused once"
    ALWAYS = "refused always"
    GARBAGE = "answered with garbage"
    LOST = "lost"

    @property
    def refuses(self) -> bool:
        """Whether the device says no."""
        return self in (Manner.ONCE, Manner.ALWAYS)


class Requests:
    """Counts the requests of a driver, one of which does not get what it wants."""

    def __init__(self, number: int, manner: Manner) -> None:
        self.manner = manner
        self.asked: list[str] = []  # All of them; equal ones are the same request.
        self._number = number
        self._draw = np.random.default_rng(number + 1)
        self._is_spoilt = False

    def is_it(self, *request: object) -> bool:
        """Note a request; return whether it is the one."""
        asked = " ".join(map(str, request))
        self.asked.append(asked)
        place = len(self.asked) - 1
        is_again = self.manner is Manner.ALWAYS and self.asked.index(asked) == self._number
        # What a subscription brings is no answer to it.
        if place == self._number and self.manner is Manner.GARBAGE and request[0] != "subscribe":
            self._is_spoilt = True
        return place == self._number or is_again

    def spoilt(self, answer: bytes) -> bytes:
        """Return what comes next, or garbage in its place."""
        if not self._is_spoilt:
            return answer
        self._is_spoilt = False
        return self._draw.bytes(int(self._draw.integers(0, len(answer) + 4)))


@contextmanager
def over_the_air(requests: Requests) -> Generator[None]:
    """Meddle with what is asked by GATT."""
    read, write, subscribe = GattLink.read, GattLink.write, GattLink.subscribe

    def refuse(handle: int) -> None:
        if requests.manner.refuses:
            raise ATT_Error(ATT_REFUSED, handle)

    async def meddled_read(self: GattLink, attribute: Any) -> bytes:
        if requests.is_it("read", attribute.handle):
            refuse(attribute.handle)
        return requests.spoilt(await read(self, attribute))

    async def meddled_write(self: GattLink, attribute: Any, data: bytes, *, response: bool) -> None:
        if requests.is_it("write", attribute.handle, data.hex()):
            if response:
                refuse(attribute.handle)
            if requests.manner is not Manner.GARBAGE:
                return
        await write(self, attribute, data, response=response)

    async def meddled_subscribe(self: GattLink, characteristic: Any, on_value: OnValue) -> None:
        if requests.is_it("subscribe", characteristic.handle):
            refuse(characteristic.handle)
        await subscribe(self, characteristic, lambda value: on_value(requests.spoilt(value)))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(GattLink, "read", meddled_read)
        patch.setattr(GattLink, "write", meddled_write)
        patch.setattr(GattLink, "subscribe", meddled_subscribe)
        yield


def refused(sensor: str, request: bytes) -> bytes:
    """Return how a device that is asked by bytes refuses, as ``tests/<sensor>/refusal.py`` says."""
    return import_module(f"tests.{sensor}.refusal").refusal(request)


@contextmanager
def over_bytes(requests: Requests, sensor: str) -> Generator[None]:
    """Meddle with what is asked by serial port and TCP."""
    deliver = Traffic.deliver

    def meddled(write: Callable[[Any, bytes], None]) -> Callable[[Any, bytes], None]:
        def meddled_write(self: Any, data: bytes) -> None:
            if requests.is_it("write", data.hex()) and requests.manner is not Manner.GARBAGE:
                if requests.manner.refuses:
                    deliver(self._traffic, refused(sensor, data), LSL_CLOCK())
                return
            write(self, data)

        return meddled_write

    def meddled_deliver(self: Traffic, data: bytes, arrival: float) -> None:
        deliver(self, requests.spoilt(data), arrival)

    with pytest.MonkeyPatch.context() as patch:
        for link in (MemorySerialLink, MemoryTcpLink):
            patch.setattr(link, "write", meddled(link.write))
        patch.setattr(Traffic, "deliver", meddled_deliver)
        yield


@contextmanager
def over_a_websocket(requests: Requests) -> Generator[None]:
    """Meddle with what is asked by JSON-RPC."""
    send, keep = WebSocketLink.send, WebSocketLink._keep

    async def meddled_send(self: WebSocketLink, text: str) -> None:
        asked = json.loads(text)
        if not requests.is_it(asked["method"], asked.get("params")):
            await send(self, text)
        elif requests.manner.refuses:
            error = {"code": -32600, "message": "refused"}
            reply = json.dumps({"jsonrpc": "2.0", "id": asked["id"], "error": error})
            keep(self, ReceivedText(reply, LSL_CLOCK()))
        elif requests.manner is Manner.GARBAGE:
            await send(self, text)

    def meddled_keep(self: WebSocketLink, message: ReceivedText) -> None:
        text = requests.spoilt(message.text.encode()).decode(errors="replace")
        keep(self, message._replace(text=text))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(WebSocketLink, "send", meddled_send)
        patch.setattr(WebSocketLink, "_keep", meddled_keep)
        yield


@contextmanager
def meddled_with(device: VirtualDevice, requests: Requests) -> Generator[None]:
    """Let these requests be all that its driver asks."""
    with (
        over_the_air(requests),
        over_bytes(requests, device.sensor),
        over_a_websocket(requests),
    ):
        yield


def streams_of_now(run: Run) -> set[str]:
    """Return the streams that came lately, and all states."""
    since_s = run.sink.clock() - OF_NOW_S
    return {
        name
        for name, times in run.sink.times.items()
        if times and (times[-1] > since_s or run.sink.spec.stream(name).is_state)
    }


def untrue(device: VirtualDevice, run: Run, since_s: float) -> list[str]:
    """Return what came and was not measured, not in order, or stamped with another time."""
    found: list[str] = []
    for name in measured(device):
        try:
            errors_s = errors_by_place(device, run, name, since_s)
        except AssertionError as error:
            found.append(f"{name}: {error}")
            continue
        limit_s = STAMP_LIMIT_S + device.expected.unstamped_s.get(name, 0.0)
        if np.abs(errors_s).max(initial=0.0) > limit_s:
            # Values that repeat may lie elsewhere, too.
            errors_s = errors_by_value(device, run, name, since_s)
        if np.abs(errors_s).max(initial=0.0) > limit_s:
            found.append(f"{name}: stamps are off by {np.abs(errors_s).max():.3f} s")
    for name, column, _ in declaration(device.sensor).channels_of(ChannelRole.CONTACT):
        # It is worn all the time.
        if 0 in [row[column] for row in run.sink.rows[name]]:
            found.append(f"{name}: no contact")
    return found


_unspoilt: dict[str, tuple[list[str], set[str]]] = {}
"""By device, what its driver asks if nothing fails, and the streams that come; the same for all
manners, so it is tried once."""


def _is_asked(name: str) -> bool:
    """Whether a driver asks this virtual device what it asks no other."""
    if name == "acme_band" or is_recording(name) or class_of(name).only_advertises:
        return False
    sensor, _, kind = name.partition(":")
    try:
        module = import_module(f"tests.{sensor}.refusal")
    except ModuleNotFoundError:
        return True
    return kind in getattr(module, "ASKED", (kind,))


ASKED = list(filter(_is_asked, NAMES))


@pytest.mark.nightly
@pytest.mark.in_memory
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("manner", Manner)
@pytest.mark.parametrize("name", ASKED, indirect=True)
async def test_each_request_may_fail_and_what_is_missing_is_said(
    make: Make, name: str, manner: Manner, monkeypatch: pytest.MonkeyPatch
) -> None:
    failures: list[str] = []

    def note(text: str, **details: object) -> None:
        failures.append(f"{text}: {details.get('exc_info')!r}")

    monkeypatch.setattr(supervisor._log, "error", note)

    async def tried(number: int) -> tuple[Requests, set[str], list[str]]:
        requests = Requests(number, manner)
        failures.clear()
        with make() as device, meddled_with(device, requests):
            for variable, text in device.environment.items():
                monkeypatch.setenv(variable, text)
            async with streaming(device) as run:
                run.may_refuse = True
                begin_s = run.sink.clock()
                await asyncio.sleep(SECONDS)
                came, error = streams_of_now(run), run.error
                # What is said to be doubtful may be wrong.
                doubtful = "; ".join(run.sink.watch.remarks.values())
                # What is told from a signal is not there without it.
                gone = all_came - came - ({"quality"} if "refuses" in error else set())
                unsaid: list[str] = [each for each in gone if each not in error]
                if run.supervisor.state is not State.STREAMING and error:
                    unsaid.clear()
            found = untrue(device, run, begin_s + SETTLED_S)
            wrong = [*failures, *(each for each in found if each.split(":")[0] not in doubtful)]
            wrong += [f"{each} is missing, and {error!r} is said" for each in unsaid]
            return requests, came, wrong

    all_came: set[str] = set()
    if name not in _unspoilt:
        requests, came, wrong = await tried(-1)
        assert not wrong
        _unspoilt[name] = requests.asked, came
    asked, all_came = _unspoilt[name]
    places = [n for n, each in enumerate(asked) if asked.index(each) == n]
    assert places
    found = {asked[n]: found for n in places if (found := (await tried(n))[2])}
    assert not found


@pytest.mark.parametrize("answer", [None, b"", b"\xff\x00"])
@ON_AIR
async def test_a_battery_that_cannot_be_read_is_said(
    device: VirtualDevice, answer: bytes | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, asked = GattLink.read, list[UUID]()

    async def denying(self: GattLink, attribute: Any) -> bytes:
        if attribute.uuid != BATTERY_LEVEL:
            return await read(self, attribute)
        asked.append(attribute.uuid)
        if answer is None:
            raise ATT_Error(ATT_REFUSED, attribute.handle)
        return answer

    monkeypatch.setattr(GattLink, "read", denying)
    async with streaming(device) as run:
        await until(run.sink.has(1, *measured(device)[:1]))
        # The batteries of others come among their data.
        assert bool(asked) == ("bat (" in run.error)
