"""A UDP port that a thread reads, and the one in memory that unit tests have in its place."""

from __future__ import annotations

import errno
import socket
from collections.abc import AsyncGenerator

import pytest

from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.link import Address
from biosensor_gateway.transports.ports import UdpPort
from tests.rigs.memory_links import MemoryUdpPort
from tests.rigs.polling import until

LOCAL = "127.0.0.1"
DEADLINE_S = 30.0

Datagram = tuple[bytes, float, Address]


@pytest.fixture
def received() -> list[Datagram]:
    return []


@pytest.fixture(params=["in memory", pytest.param("real", marks=pytest.mark.seam)])
async def port(request: pytest.FixtureRequest, received: list[Datagram]) -> AsyncGenerator[UdpPort]:
    made = MemoryUdpPort(LOCAL) if request.param == "in memory" else UdpPort(LOCAL)

    def take(data: bytes, arrival_s: float, sender: Address) -> None:
        received.append((data, arrival_s, sender))

    def lost(error: OSError) -> None:
        raise error

    made.listen(take, lost)
    yield made
    number = made.number
    await made.close()
    # It is free again at once.
    UdpPort(LOCAL, number).end()


async def test_datagrams_come_whole_with_their_time_and_sender(
    port: UdpPort, received: list[Datagram]
) -> None:
    begun_s = LSL_CLOCK()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in (b"one", b"", b"three" * 1000):
            sender.sendto(data, (LOCAL, port.number))
        await until(lambda: len(received) == 3)
        address = sender.getsockname()[1]
    assert [data for data, _, _ in received] == [b"one", b"", b"three" * 1000]
    times_s = [begun_s, *(arrival_s for _, arrival_s, _ in received), LSL_CLOCK()]
    assert times_s == sorted(times_s)
    assert {sender for _, _, sender in received} == {(LOCAL, address)}


async def test_answers_go_where_they_are_sent_and_to_nobody_do_no_harm(
    port: UdpPort, received: list[Datagram]
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
    await until(lambda: bool(received))
    assert received[0][0] == b"to itself"


async def test_a_port_that_another_program_has_is_refused(port: UdpPort) -> None:
    with pytest.raises(OSError, match=r".") as caught:
        UdpPort(LOCAL, port.number)
    assert caught.value.errno == errno.EADDRINUSE
