"""The port under a virtual device, as a host sees it, on all kinds of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
import serial

from biosensor_gateway.simulation.async_serial import AsyncSerialPort, serial_port
from biosensor_gateway.simulation.world import World
from tests.rigs.virtual_time import pause

# The virtual Shimmer3 on a real serial port, heard through plain pyserial.

DEADLINE_S = 20.0


# The port under a virtual device in a loop, as a host sees it, on all kinds of it.
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
def port_device(request: pytest.FixtureRequest) -> Iterator[Device]:
    with World() as world:
        running = Device(world, tcp=request.param)
        running.open()
        yield running
        running.dispose()


def connect(port_device: Device) -> serial.SerialBase:
    return serial.serial_for_url(port_device.port.name, 115200, timeout=0.05)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        pause(0.005)


def greeted(port_device: Device) -> serial.SerialBase:
    """Connect and be heard: from then on the device can speak."""
    host, before = connect(port_device), len(port_device.heard)
    host.write(b"hello")
    until(lambda: len(port_device.heard) == before + 5)
    return host


def read(host: serial.SerialBase, count: int) -> bytes:
    host.timeout = DEADLINE_S
    return host.read(count)


def test_every_byte_passes_both_ways(port_device: Device) -> None:
    every = bytes(range(256))
    with connect(port_device) as host:
        host.write(every)
        until(lambda: len(port_device.heard) == 256)
        assert bytes(port_device.heard) == every
        assert port_device.write(every)
        assert read(host, 256) == every


def test_a_host_that_leaves_is_noticed_and_the_next_one_hears_nothing_old(
    port_device: Device,
) -> None:
    host = greeted(port_device)
    assert port_device.write(b"never read")
    host.close()
    until(lambda: port_device.left == 1)
    assert not port_device.write(b"to nobody")
    with greeted(port_device) as another:
        assert port_device.write(b"new")
        assert read(another, 3) == b"new"
    until(lambda: port_device.left == 2)


def test_a_host_sees_the_hang_up_and_finds_the_port_again_under_its_name(
    port_device: Device,
) -> None:
    name = port_device.port.name
    for _ in range(3):
        host = greeted(port_device)
        port_device.hang_up()
        with pytest.raises(OSError):
            read(host, 1)
        host.close()
        with pytest.raises(OSError):
            connect(port_device)
        port_device.open()
        assert port_device.port.name == name
    assert port_device.left == 0


def test_a_message_is_taken_whole_or_not_at_all(port_device: Device) -> None:
    message = bytes(range(100))
    with greeted(port_device) as host:
        taken = 0
        while port_device.write(message):
            taken += 1
        assert not port_device.write(message)
        assert read(host, 100 * taken) == taken * message
        until(lambda: port_device.write(b"again"))
        assert read(host, 5) == b"again"


def test_a_second_host_of_a_tcp_port_is_sent_away() -> None:
    with World() as world:
        port_device = Device(world, tcp=True)
        port_device.open()
        with greeted(port_device) as host, connect(port_device) as second:
            with pytest.raises(OSError):
                read(second, 1)
            assert port_device.write(b"first")
            assert read(host, 5) == b"first"
        port_device.dispose()
