"""The link to an EmotiBit, without one."""

from __future__ import annotations

import socket
import time

import pytest

from biosensor_gateway.devices.emotibit.driver.link import Link
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.ports import SYSTEM_PORTS
from biosensor_gateway.transports.tap import LinkTap

HERE = "127.0.0.1"
DATAGRAMS = 5
PAUSE_S, BUSY_S = 0.1, 2.0

# Only a real port is read while the loop is busy.
pytestmark = pytest.mark.nightly


def sent_while_nothing_else_runs(data_port: int) -> list[float]:
    """Send some packets, one after another, and let the loop have no turn for a while."""
    times_s: list[float] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        for number in range(DATAGRAMS):
            times_s.append(LSL_CLOCK())
            device.sendto(b"1,%d,1,HR,1,100,70\n" % number, (HERE, data_port))
            time.sleep(PAUSE_S)
    time.sleep(BUSY_S)
    return times_s


async def test_what_comes_while_the_agent_is_busy_has_the_time_of_its_arrival() -> None:
    link = Link("EmotiBit 1", HERE, SYSTEM_PORTS, LinkTap(LSL_CLOCK))
    await link.open()
    sent_s = sent_while_nothing_else_runs(int(link.data_payload[1]))
    arrived = [await link.read() for _ in sent_s]
    await link.close()
    assert [each.found.packets[0].number for each in arrived] == list(range(DATAGRAMS))
    for each, sent in zip(arrived, sent_s, strict=True):
        assert sent <= each.arrival_s < sent + BUSY_S
