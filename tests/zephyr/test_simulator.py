"""The virtual BioHarness, heard by a host of serial ports."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import serial

from biosensor_gateway.devices.zephyr.simulator.recording import (
    RECORDING_150_S,
    RECORDING_WITH_GAP,
    RecordedSource,
)
from biosensor_gateway.devices.zephyr.simulator.wire import Packet
from biosensor_gateway.devices.zephyr.simulator.zephyr import SyntheticSource
from tests.rigs.serial_hosts import SerialHosts
from tests.rigs.virtual_time import pause
from tests.rigs.zephyr import ROOMY_BYTES, SteeredBioHarness

DEADLINE_S = 8.0
ECG_ON = bytes.fromhex("021601015e03")
RR_ON = bytes.fromhex("021901015e03")
SUMMARY_ON = bytes.fromhex("02bd020100c403")
LIFESIGN = bytes.fromhex("0223000003")
ENABLES = b"".join(
    (ECG_ON, bytes.fromhex("021501015e03"), RR_ON, bytes.fromhex("021e01015e03"), SUMMARY_ON)
)
DISABLES = bytes.fromhex("021601000003021501000003021901000003021e0100000302bd0200000003")
FIVE_ACKS = bytes.fromhex("0216000006021500000602190000060 21e00000602bd000006".replace(" ", ""))
ACK, NAK = 0x06, 0x15
RECORDINGS = (
    Path(__file__).parents[2] / "gateway_win/biosensor_gateway/devices/zephyr/simulator/recordings"
)


class Heard(NamedTuple):
    """A frame as this file's own small reader sees it."""

    message_id: int
    end: int
    payload: bytes
    raw: bytes


def check_of(payload: bytes) -> int:
    value = 0
    for bit in (byte >> k & 1 for byte in payload for k in range(8)):
        value = (value >> 1) ^ (0x8C if (value ^ bit) & 1 else 0)
    return value


def ten_bits(data: bytes, count: int) -> list[int]:
    bits = "".join(f"{byte:08b}"[::-1] for byte in data)
    return [int(bits[10 * k : 10 * k + 10][::-1], 2) for k in range(count)]


class Host:
    """The other end: sends bytes, cuts what it hears into frames, counts the rest."""

    def __init__(self, port: str) -> None:
        self._serial = serial.Serial(port, 115200, timeout=0.02, write_timeout=2)
        self._unread = b""
        self.raw = b""
        self.frames: list[Heard] = []
        self.junk = 0

    def send(self, data: bytes) -> None:
        self._serial.write(data)

    def listen(self) -> None:
        data = self._serial.read(1)
        data += self._serial.read(self._serial.in_waiting)
        self.raw += data
        self._unread += data
        while len(self._unread) >= 5:
            size = self._unread[2] + 5
            if self._unread[0] == 2 and size <= 133 and len(self._unread) < size:
                return
            raw = self._unread[:size]
            if (
                raw[0] == 2
                and size <= 133
                and check_of(raw[3:-2]) == raw[-2]
                and raw[-1] in b"\3\6\x15"
            ):
                self.frames.append(Heard(raw[1], raw[-1], raw[3:-2], raw))
                self._unread = self._unread[size:]
            else:
                self._unread = self._unread[1:]
                self.junk += 1

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, "the device did not do it"
            self.listen()

    def of(self, message_id: int, end: int = 0x03) -> list[Heard]:
        return [
            heard for heard in self.frames if (heard.message_id, heard.end) == (message_id, end)
        ]

    def ask(self, request: bytes) -> int:
        """Send a request; return how its answer ends."""
        before = len(self.answers)
        self.send(request)
        self.until(lambda: len(self.answers) > before)
        assert self.answers[before].message_id == request[1]
        return self.answers[before].end

    @property
    def answers(self) -> list[Heard]:
        return [heard for heard in self.frames if heard.end in (ACK, NAK)]

    def close(self) -> None:
        self._serial.close()


class PluggedDevice:
    """The device of one test and its hosts, ended with it."""

    device: SteeredBioHarness

    def __init__(self) -> None:
        self._hosts = SerialHosts(Host)

    def start(self, device: SteeredBioHarness) -> Host:
        self.device = device
        device.start()
        return self.connect()

    def connect(self) -> Host:
        return self._hosts.connect(self.device.port)

    def close(self) -> None:
        self._hosts.close()
        self.device.stop()


@pytest.fixture
def bench() -> Iterator[PluggedDevice]:
    bench = PluggedDevice()
    yield bench
    bench.close()


def fast(speed: float = 30.0) -> SyntheticSource:
    return SyntheticSource(seed=3, speed=speed)


def test_it_is_silent_until_the_host_speaks_and_never_answers_a_lifesign(
    bench: PluggedDevice,
) -> None:
    host = bench.start(SteeredBioHarness(fast(), lifesign_s=0.02))
    pause(0.1)
    host.listen()
    assert host.raw == b""
    host.send(LIFESIGN)
    host.until(lambda: len(host.frames) >= 3)
    assert {heard.raw for heard in host.frames} == {LIFESIGN}


@pytest.mark.parametrize(
    "request_hex",
    [
        "021601015f03",
        "0216010199 03",
        "021602 0100c403",
        "02160103e203",
        "029c000003",
        "02bd01015e03",
    ],
    ids=["check", "other check", "length", "value", "unsupported", "summary length"],
)
def test_a_wrong_request_is_refused_without_effect(bench: PluggedDevice, request_hex: str) -> None:
    host = bench.start(SteeredBioHarness())
    assert host.ask(bytes.fromhex(request_hex)) == NAK
    assert bench.device.enabled == frozenset()


def test_what_is_heard_is_what_was_sent(bench: PluggedDevice) -> None:
    host = bench.start(SteeredBioHarness(fast(), buffer_bytes=ROOMY_BYTES))
    host.send(ENABLES)
    host.until(lambda: len(host.of(Packet.SUMMARY)) >= 20)
    host.send(DISABLES)
    host.until(lambda: len(host.answers) == 10)
    device = bench.device
    assert device.dropped_frames == 0
    assert host.junk == 0
    periodic = [heard.raw for heard in host.frames if heard.end == 3 and heard.raw != LIFESIGN]
    assert periodic == [out.data for out in device.sent]
    for packet, count in ((Packet.ECG, 63), (Packet.BREATHING, 18), (Packet.ACCELERATION, 60)):
        heard = [v for f in host.of(packet) for v in ten_bits(f.payload[9:], count)]
        assert heard == device.sent_samples(packet)[:, 1:].ravel().tolist()
    rr = np.frombuffer(b"".join(f.payload[9:] for f in host.of(Packet.RR)), "<i2")
    assert rr.tolist() == device.sent_samples(Packet.RR)[:, 1].tolist()
    for heard, out in zip(
        host.of(Packet.SUMMARY), (o for o in device.sent if o.packet is Packet.SUMMARY), strict=True
    ):
        assert out.values is not None
        assert int.from_bytes(heard.payload[10:12], "little") == out.values["heart_rate_bpm"]
        assert heard.payload[0] == (out.sequence or 0) & 0xFF


@pytest.mark.parametrize("name", [RECORDING_150_S, RECORDING_WITH_GAP])
def test_a_recording_is_played_byte_for_byte_without_its_answers(
    bench: PluggedDevice, name: str
) -> None:
    source = RecordedSource.shipped(name, speed=500)
    host = bench.start(SteeredBioHarness(source, buffer_bytes=ROOMY_BYTES))
    recorded = (RECORDINGS / f"{name}.dat").read_bytes()
    for answer in (FIVE_ACKS[k : k + 5] for k in range(0, 25, 5)):
        assert recorded.count(answer) == 1
        recorded = recorded.replace(answer, b"")
    host.send(ENABLES)
    host.until(lambda: len(host.raw) >= len(FIVE_ACKS) + len(recorded))
    assert host.raw == FIVE_ACKS + recorded
    assert b"".join(out.data for out in bench.device.sent) == recorded


def test_a_host_that_says_nothing_is_forgotten(bench: PluggedDevice) -> None:
    host = bench.start(SteeredBioHarness(fast(), host_timeout_s=0.15))
    host.ask(ECG_ON)
    host.until(lambda: bench.device.enabled == frozenset())
    sent = len(bench.device.sent)
    pause(0.1)
    assert len(bench.device.sent) == sent
    assert host.ask(ECG_ON) == ACK
