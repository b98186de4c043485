"""The virtual Shimmer3 on a real serial port, heard through it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pytest
import serial

from biosensor_gateway.devices.shimmer3_gsr.simulator import SimulatedShimmer3
from biosensor_gateway.simulation.async_serial import AsyncSerialPort, serial_port
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.rigs.serial_hosts import SerialHosts
from tests.rigs.virtual_time import pause

# The virtual Shimmer3 on a real serial port, heard through plain pyserial.

DEADLINE_S = 20.0
RESISTORS_KOHM = (40.2, 287.0, 1000.0, 3300.0)
GSR_PPG_128_HZ = ("08040100", "2104", "5e01", "050001")


def check_of(message: bytes) -> bytes:
    crc = 0xB0CA
    for byte in message + bytes(len(message) % 2):
        for bit in range(7, -1, -1):
            high = crc >> 15 ^ (byte >> bit & 1)
            crc = (crc << 1 & 0xFFFF) ^ (0x1021 if high else 0)
    return bytes((crc & 0xFF, crc >> 8))


class Packet(NamedTuple):
    """A packet of skin conductance and pulse as this file's own decoder sees it."""

    ticks: int
    ppg_mv: float
    gsr_us: float
    gsr_range: int


def decoded(body: bytes) -> Packet:
    raw = body[6] | body[7] << 8
    gsr_range, counts = raw >> 14, raw & 0xFFF
    volts = 3 * counts / 4095
    electrodes_open = counts <= (683 if gsr_range == 3 else 682)
    gsr_us = math.nan if electrodes_open else (volts / 0.5 - 1) * 1000 / RESISTORS_KOHM[gsr_range]
    ppg_mv = (body[4] | body[5] << 8) * 3000 / 4095
    return Packet(int.from_bytes(body[1:4], "little"), ppg_mv, gsr_us, gsr_range)


class Host:
    """The other end of the port."""

    def __init__(self, port: str) -> None:
        self._serial = serial.serial_for_url(port, 115200, timeout=0.05)
        self.unread = b""

    def send(self, command: str) -> None:
        self._serial.write(bytes.fromhex(command))

    def listen(self) -> None:
        data = self._serial.read(1)
        self.unread += data + self._serial.read(self._serial.in_waiting)

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, f"only {self.unread.hex()} came"
            self.listen()

    def take(self, count: int) -> bytes:
        self.until(lambda: len(self.unread) >= count)
        data, self.unread = self.unread[:count], self.unread[count:]
        return data

    def ask(self, command: str, count: int = 1) -> str:
        self.send(command)
        return self.take(count).hex()

    def ask_all(self, *commands: str) -> None:
        for command in commands:
            assert self.ask(command) == "ff"

    def packets(self, count: int, crc_bytes: int = 0) -> list[Packet]:
        packets: list[Packet] = []
        for _ in range(count):
            body = self.take(8 + crc_bytes)
            assert body[0] == 0
            assert check_of(body[:8])[:crc_bytes] == body[8:]
            packets.append(decoded(body))
        return packets

    def after_packets(self, count: int) -> str:
        """Skip data packets of this file's kind; take what is none."""
        while (first := self.take(1)) == b"\0":
            self.take(7)
        return (first + self.take(count - 1)).hex()

    def is_quiet(self) -> bool:
        """Whether nothing is said before the answer to a ping, and no answer comes twice."""
        return self.ask("96") == "ff" and not self.unread

    def close(self) -> None:
        self._serial.close()


@pytest.fixture
def world() -> Iterator[World]:
    with World() as running:
        yield running


@pytest.fixture
def hosts() -> Iterator[SerialHosts[Host]]:
    running = SerialHosts(Host)
    yield running
    running.close()


@pytest.fixture(params=[False, True], ids=["pty", "tcp"])
def device(world: World, request: pytest.FixtureRequest) -> Iterator[SimulatedShimmer3]:
    with SimulatedShimmer3(world, seed=3, jitter_s=0.01, tcp=request.param) as running:
        yield running


@pytest.fixture
def host(hosts: SerialHosts[Host], device: SimulatedShimmer3) -> Host:
    return hosts.connect(device.port)


def settled(device: SimulatedShimmer3, data_name: str, count: int) -> None:
    """Wait until the truth holds so many samples: it is noted just after the sending."""
    deadline = time.monotonic() + DEADLINE_S
    while len(device.truth.samples(data_name).times) < count:
        assert time.monotonic() < deadline
        pause(0.01)


def gaps(packets: list[Packet]) -> list[int]:
    ticks = np.array([packet.ticks for packet in packets])
    return [int(gap) for gap in np.diff(ticks) % (1 << 24)]


def test_the_recommended_conversation(host: Host) -> None:
    assert host.ask("20") == "ff"
    assert host.ask("3f", 3) == "ff2503"
    assert host.ask("2e", 8) == "ff2f030001000102"
    assert host.ask("a300") == "ff"
    assert host.ask("8b01", 2) == "fff4"
    assert host.ask("660300", 7)[:-2] == "ff6503300400"
    for command in GSR_PPG_128_HZ:
        assert host.ask(command, 2) == "fff4"
    inquiry = bytes.fromhex(host.ask("01", 13))
    assert inquiry[:-1].hex() == "ff02000101ff01090201121c"
    assert check_of(inquiry[:-1])[:1] == inquiry[-1:]
    assert host.ask("95", 7)[:6] == "ff8a94"
    assert host.ask("72", 5)[:8] == "ff8a7120"
    assert host.ask("07", 2) == "fff4"
    packets = host.packets(60, crc_bytes=1)
    assert set(gaps(packets)) == {256}
    host.send("20")
    host.until(lambda: host.unread.endswith(b"\xff\xf4"))


def test_no_packet_leaves_before_it_was_measured(host: Host, device: SimulatedShimmer3) -> None:
    host.ask_all(*GSR_PPG_128_HZ, "07")
    host.packets(30)
    heard_s = LSL_CLOCK()
    settled(device, "gsr", 30)
    assert device.truth.samples("gsr").times[29] < heard_s


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
