"""The virtual BioHarness 3: its truth against the wire, and every fault."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pytest
import serial
from numpy.typing import NDArray

from biosensor_gateway.devices.zephyr.simulator.zephyr import SimulatedZephyr
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.truth import Samples
from biosensor_gateway.simulation.world import World
from tests.rigs.serial_hosts import SerialHosts
from tests.rigs.virtual_time import pause

DEADLINE_S = 20.0
ECG_ON = bytes.fromhex("021601015e03")
BREATHING, ECG, RR, ACC, SUMMARY = 0x21, 0x22, 0x24, 0x25, 0x2B
ACK, NAK = 0x06, 0x15


class Heard(NamedTuple):
    """A frame as this file's own small reader sees it."""

    message_id: int
    end: int
    payload: bytes

    @property
    def sequence(self) -> int:
        return self.payload[0]

    @property
    def device_ms(self) -> int:
        return int.from_bytes(self.payload[5:9], "little")

    def counts(self) -> NDArray[np.int64]:
        """Values of ten bits, the first in the lowest bits."""
        bits = int.from_bytes(self.payload[9:], "little")
        count = 8 * len(self.payload[9:]) // 10
        return np.array([bits >> 10 * k & 0x3FF for k in range(count)], np.int64)


class Host:
    """The other end of the port."""

    def __init__(self, port: str) -> None:
        self._serial = serial.Serial(port, 115200, timeout=0.02, write_timeout=2)
        self._unread = b""
        self.junk = 0
        self.frames: list[Heard] = []

    def send(self, data: bytes) -> None:
        self._serial.write(data)

    def listen(self) -> None:
        data = self._serial.read(1)
        self._unread += data + self._serial.read(self._serial.in_waiting)
        while len(self._unread) >= 5:
            size = self._unread[2] + 5
            frame = self._unread[:size]
            if self._unread[0] == 2 and self._unread[2] <= 128:
                if len(self._unread) < size:
                    return
                if frame[-1] in (3, ACK, NAK):
                    self.frames.append(Heard(frame[1], frame[-1], frame[3:-2]))
                    self._unread = self._unread[size:]
                    continue
            self._unread = self._unread[1:]
            self.junk += 1

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, "the device did not do it"
            self.listen()

    def ask(self, request: bytes) -> int:
        """Send a request; return how its answer ends."""

        def answers() -> list[Heard]:
            return [
                heard
                for heard in self.frames
                if heard.message_id == request[1] and heard.end in (ACK, NAK)
            ]

        before = len(answers())
        self.send(request)
        self.until(lambda: len(answers()) > before)
        return answers()[-1].end

    def of(self, message_id: int) -> list[Heard]:
        return [each for each in self.frames if (each.message_id, each.end) == (message_id, 3)]

    def wait_for(self, message_id: int, count: int) -> list[Heard]:
        self.until(lambda: len(self.of(message_id)) >= count)
        return self.of(message_id)

    def until_hung_up(self) -> None:
        with pytest.raises(OSError):
            self.until(lambda: False)

    def close(self) -> None:
        self._serial.close()


@pytest.fixture
def hosts() -> Iterator[SerialHosts[Host]]:
    running = SerialHosts(Host)
    yield running
    running.close()


@pytest.fixture
def device() -> Iterator[SimulatedZephyr]:
    with World() as world, SimulatedZephyr(world, seed=5) as running:
        yield running


@pytest.fixture
def host(hosts: SerialHosts[Host], device: SimulatedZephyr) -> Host:
    return hosts.connect(device.settings["port"])


def settled(device: SimulatedZephyr, data_name: str, count: int) -> Samples:
    """Wait until the truth holds so many samples: it is noted just after the sending."""
    deadline = time.monotonic() + DEADLINE_S
    while len((found := device.truth.samples(data_name)).times) < count:
        assert time.monotonic() < deadline
        pause(0.01)
    return found


def test_restart_begins_with_packet_0_and_a_clock_that_went_on(
    hosts: SerialHosts[Host], host: Host, device: SimulatedZephyr
) -> None:
    assert host.ask(ECG_ON) == ACK
    before = host.wait_for(ECG, 6)[-1]
    device.apply(Fault(FaultKind.RESTART, 0.3))
    host.until_hung_up()
    again = hosts.connect(device.settings["port"])
    assert again.ask(ECG_ON) == ACK
    after = again.wait_for(ECG, 1)[0]
    assert after.sequence < before.sequence
    assert after.device_ms > before.device_ms


def test_a_restart_ends_no_drop(
    hosts: SerialHosts[Host], host: Host, device: SimulatedZephyr
) -> None:
    device.apply(Fault(FaultKind.DROP, math.inf))
    host.until_hung_up()
    device.apply(Fault(FaultKind.RESTART, math.inf))
    device.clear(FaultKind.RESTART)
    with pytest.raises(OSError):
        Host(device.settings["port"])
    device.clear(FaultKind.DROP)
    assert hosts.connect(device.settings["port"]).ask(ECG_ON) == ACK


def test_drift_changes_the_pace_of_the_truth(host: Host, device: SimulatedZephyr) -> None:
    assert host.ask(ECG_ON) == ACK
    host.wait_for(ECG, 2)
    device.apply(Fault(FaultKind.DRIFT, 50_000))
    numbers = [each.sequence for each in host.wait_for(ECG, 8)]
    assert set(np.diff(numbers)) == {1}
    steps = np.diff(settled(device, "ecg", 8 * 63).times)
    assert steps[0] == pytest.approx(0.004, rel=1e-4)
    assert steps[-1] == pytest.approx(0.004 / 1.05, rel=1e-4)
