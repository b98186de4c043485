"""What can befall single lines and answers of the virtual E4 server."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.empatica_e4.simulator.e4 import damaged_line
from biosensor_gateway.simulation.world import World
from tests.empatica_e4.steering import SteeredE4
from tests.rigs.virtual_time import pause

DEADLINE_S = 20.0
STEP_S = 1 / 63.997


def eventually(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        pause(0.01)


def assert_broken_off(client: Any) -> None:
    with pytest.raises(ConnectionResetError):
        client.until_closed()


def stamps(client: Any, word: str = "E4_Bvp") -> list[float]:
    return [line.stamp for line in client.lines(word)]


@given(st.integers(0, 2**32))
def test_garbage_is_never_mistaken_for_a_sample(seed: int) -> None:
    line = damaged_line(np.random.default_rng(seed))
    assert line.endswith(b"\r\n")
    assert line.count(b"\n") == 1
    words = line.decode("utf-8", "replace").replace(",", ".").split()
    with pytest.raises((ValueError, IndexError)):
        fields = {"E4_Bvp": 2, "E4_Gsr": 2, "E4_Acc": 4}
        if words[0] not in fields or len(words) != fields[words[0]] + 1:
            raise ValueError
        if not np.isfinite([float(word) for word in words[1:]]).all():
            raise ValueError


def test_a_client_that_does_not_read_loses_nothing_for_long_and_blocks_nobody(
    world: World, line_client: Any
) -> None:
    with (
        SteeredE4(world) as server,
        line_client(server.settings) as slow,
        line_client(server.settings) as client,
    ):
        slow.begin(streams="bvp")
        client.begin(streams="bvp")
        for _ in range(30):
            server.send_raw(b"x" * 10_000 + b"\r\n")
        client.until_lines("E4_Bvp", 50)
        slow.until_lines("E4_Bvp", 50)
        assert abs(np.diff(stamps(slow)) / STEP_S - 1).max() < 2e-3


def test_connections_can_be_broken_off(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server:
        with line_client(server.settings) as client:
            client.begin()
            server.close_connections()
            assert_broken_off(client)
        eventually(lambda: server.client_count == 0)
        with line_client(server.settings) as again:
            again.begin()
