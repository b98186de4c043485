"""The port under a virtual device in a loop, as a host sees it, on all kinds of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
import serial

from biosensor_gateway.simulation.async_serial import AsyncSerialPort, serial_port
from biosensor_gateway.simulation.world import World
from tests.rigs.virtual_time import pause

DEADLINE_S = 20.0
BUFFER_BYTES = 256


class Device:
    """Notes what it hears, and sees to its port in the world's thread."""

    def __init__(self, world: World, *, tcp: bool) -> None:
        self.heard = bytearray()
        self.left = 0
        self._world = world
        self.port: AsyncSerialPort = world.call(
            lambda: serial_port(
                self.heard.extend, self._host_left, buffer_bytes=BUFFER_BYTES, tcp=tcp
            )
        )

    def _host_left(self) -> None:
        self.left += 1

    def open(self) -> None:
        self._world.call(self.port.open)

    def write(self, data: bytes) -> bool:
        return self._world.call(lambda: self.port.write(data))

    def hang_up(self) -> None:
        self._world.call(self.port.hang_up)

    def dispose(self) -> None:
        self._world.call(self.port.dispose)


# What is in memory has to be as the real ones are.
@pytest.fixture(
    params=[
        pytest.param(False, id="in memory"),
        pytest.param(True, id="tcp in memory"),
        pytest.param(False, id="pty", marks=pytest.mark.nightly),
        pytest.param(True, id="tcp", marks=pytest.mark.nightly),
    ]
)
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    with World() as world:
        running = Device(world, tcp=request.param)
        running.open()
        yield running
        running.dispose()


def connect(device: Device) -> serial.SerialBase:
    return serial.serial_for_url(device.port.name, 115200, timeout=0.05)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        pause(0.005)


def greeted(device: Device) -> serial.SerialBase:
    """Connect and be heard: from then on the device can speak."""
    host, before = connect(device), len(device.heard)
    host.write(b"hello")
    until(lambda: len(device.heard) == before + 5)
    return host


def read(host: serial.SerialBase, count: int) -> bytes:
    host.timeout = DEADLINE_S
    return host.read(count)


def test_every_byte_passes_both_ways(device: Device) -> None:
    every = bytes(range(256))
    with connect(device) as host:
        host.write(every)
        until(lambda: len(device.heard) == 256)
        assert bytes(device.heard) == every
        assert device.write(every)
        assert read(host, 256) == every


def test_nothing_is_taken_without_a_host(device: Device) -> None:
    assert not device.write(b"to nobody")
    with greeted(device) as host:
        assert device.write(b"x")
        assert read(host, 1) == b"x"


def test_a_host_that_leaves_is_noticed_and_the_next_one_hears_nothing_old(
    device: Device,
) -> None:
    host = greeted(device)
    assert device.write(b"never read")
    host.close()
    until(lambda: device.left == 1)
    assert not device.write(b"to nobody")
    with greeted(device) as another:
        assert device.write(b"new")
        assert read(another, 3) == b"new"
    until(lambda: device.left == 2)


def test_what_a_host_says_last_is_heard(device: Device) -> None:
    with connect(device) as host:
        host.write(b"last words")
    until(lambda: device.left == 1 or len(device.heard) == 10)
    until(lambda: bytes(device.heard) == b"last words")


def test_a_host_sees_the_hang_up_and_finds_the_port_again_under_its_name(
    device: Device,
) -> None:
    name = device.port.name
    for _ in range(3):
        host = greeted(device)
        device.hang_up()
        with pytest.raises(OSError):
            read(host, 1)
        host.close()
        with pytest.raises(OSError):
            connect(device)
        device.open()
        assert device.port.name == name
    assert device.left == 0


def test_a_message_is_taken_whole_or_not_at_all(device: Device) -> None:
    message = bytes(range(100))
    with greeted(device) as host:
        taken = 0
        while device.write(message):
            taken += 1
        assert not device.write(message)
        assert read(host, 100 * taken) == taken * message
        until(lambda: device.write(b"again"))
        assert read(host, 5) == b"again"


def test_opening_twice_is_opening_once(device: Device) -> None:
    with greeted(device) as host:
        device.open()
        assert device.write(b"still")
        assert read(host, 5) == b"still"


def test_a_second_host_of_a_tcp_port_is_sent_away() -> None:
    with World() as world:
        device = Device(world, tcp=True)
        device.open()
        with greeted(device) as host, connect(device) as second:
            with pytest.raises(OSError):
                read(second, 1)
            assert device.write(b"first")
            assert read(host, 5) == b"first"
        device.dispose()
