"""A UDP port that a thread reads."""

from __future__ import annotations

import errno
import socket
import threading
from collections.abc import Callable, Generator

import pytest
from pylsl import local_clock

from biosensor_gateway.transports.receiving import Address
from biosensor_gateway.transports.udp_port import UdpPort

pytestmark = pytest.mark.nightly

LOCAL = "127.0.0.1"
DEADLINE_S = 30.0

Until = Callable[[Callable[[], bool]], None]
Datagram = tuple[bytes, float, Address]


@pytest.fixture
def received() -> list[Datagram]:
    return []


@pytest.fixture
def port(received: list[Datagram]) -> Generator[UdpPort]:
    made = UdpPort(LOCAL)

    def take(data: bytes, arrival_s: float, sender: Address) -> None:
        received.append((data, arrival_s, sender))

    reading = threading.Thread(target=made.read_forever, args=(take,))
    reading.start()
    yield made
    made.end()
    reading.join(DEADLINE_S)
    assert not reading.is_alive()


@pytest.mark.seam
def test_datagrams_come_whole_with_their_time_and_sender(
    port: UdpPort, received: list[Datagram], until: Until
) -> None:
    begun_s = local_clock()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in (b"one", b"", b"three" * 1000):
            sender.sendto(data, (LOCAL, port.number))
        until(lambda: len(received) == 3)
        address = sender.getsockname()[1]
    assert [data for data, _, _ in received] == [b"one", b"", b"three" * 1000]
    times_s = [begun_s, *(arrival_s for _, arrival_s, _ in received), local_clock()]
    assert times_s == sorted(times_s)
    assert {sender for _, _, sender in received} == {(LOCAL, address)}


def test_answers_go_where_they_are_sent_and_to_nobody_do_no_harm(
    port: UdpPort, received: list[Datagram], until: Until
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        asker.bind((LOCAL, 0))
        asker.settimeout(DEADLINE_S)
        port.send(b"answer", asker.getsockname())
        assert asker.recvfrom(100) == (b"answer", (LOCAL, port.number))
        gone = asker.getsockname()
    for _ in range(3):
        port.send(b"nobody listens", gone)
    port.send(b"to itself", (LOCAL, port.number))
    until(lambda: bool(received))
    assert received[0][0] == b"to itself"


def test_a_port_that_another_program_has_is_refused(port: UdpPort) -> None:
    with pytest.raises(OSError, match=r".") as caught:
        UdpPort(LOCAL, port.number)
    assert caught.value.errno == errno.EADDRINUSE
