"""What can befall the virtual E4 server: radio, connections, the process."""

from __future__ import annotations

import time
from typing import Any

from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from tests.empatica_e4.steering import SteeredE4
from tests.rigs.virtual_time import pause

ID = "9ff167"
LOST = f"R connection lost to device {ID}\n"
DEADLINE_S = 20.0


def until_accepted(line_client: Any, server: SteeredE4) -> Any:
    """Connect as soon as the port is open."""
    deadline = time.monotonic() + DEADLINE_S
    while True:
        try:
            return line_client(server.settings)
        except ConnectionRefusedError:
            assert time.monotonic() < deadline, "it did not open"
            pause(0.02)


def test_a_wristband_that_was_given_no_patience_is_off_once_it_is_lost(
    world: World, line_client: Any
) -> None:
    with (
        SteeredE4(world, automatic=False) as server,
        line_client(server.settings) as client,
    ):
        client.ask(f"device_connect_btle {ID}")
        client.begin(streams="bvp")
        server.apply(Fault(FaultKind.DROP, 0.0))
        assert client.reply() == LOST
        assert client.ask("device_discover_list") == "R device_discover_list 0\n"
        server.turn_on()
        assert client.ask("device_discover_list").endswith("allowed\n")


def test_a_restarted_server_without_automatic_connections_has_none(
    world: World, line_client: Any
) -> None:
    with SteeredE4(world, automatic=False) as server:
        with line_client(server.settings) as client:
            client.ask(f"device_connect_btle {ID} 0")
        server.apply(Fault(FaultKind.RESTART, 0.1))
        with until_accepted(line_client, server) as again:
            assert again.ask("device_list") == "R device_list 0\n"
