"""What can befall single lines and answers of the virtual E4 server."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.empatica_e4.simulator.e4 import damaged_line
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from tests.empatica_e4.steering import SteeredE4
from tests.rigs.virtual_time import pause

ID = "9ff167"
LISTED = f"R device_list 1 | {ID} Empatica_E4\n"
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


def test_garbage_stands_between_lines(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="acc")
        client.until_lines("E4_Acc", 3)
        server.apply(Fault(FaultKind.GARBAGE, 200))
        ends: list[bool] = []
        while len(ends) < 200:
            line = client.read()
            if b"E4_Acc" not in line or line.count(b" ") != 4:
                ends.append(line.endswith(b"\r\n"))
        assert all(ends)
        assert client.ask("device_list") == LISTED


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


def test_lines_are_doubled_glued_and_torn(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp")
        client.until_lines("E4_Bvp", 3)
        server.duplicate_line()
        client.until(lambda: len(set(client.data)) < len(client.data))
        assert len(client.data) - len(set(client.data)) == 1
        server.glue_lines()
        client.until(lambda: client.data[-1].count(b"E4_Bvp") == 2)
        glued = client.data.pop()
        assert glued.count(b"\r\n") == 1
        assert server.truth.unsent_count("bvp") == 2
        count = len(client.data)
        for in_line_end in (False, True):
            server.tear_line(0.1, in_line_end=in_line_end)
        client.until_lines("E4_Bvp", count + 30)
        numbers = np.rint(np.diff(stamps(client)) / STEP_S).astype(int).tolist()
        assert sorted(set(numbers)) == [0, 1, 3]
        assert numbers.count(0) == numbers.count(3) == 1
        values = [line.values[0] for line in client.lines("E4_Bvp")]
        del values[numbers.index(0)]
        assert values == server.truth.samples("bvp").values[: len(values), 0].tolist()


def test_a_torn_line_comes_in_two_reads(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="acc")
        server.tear_line(0.3)
        pieces: list[bytes] = []
        while not pieces or pieces[-1].endswith(b"\r\n"):
            pieces.append(client.socket.recv(4096))
        pieces.append(client.socket.recv(4096))
        whole = (pieces[-2] + pieces[-1]).splitlines()
        assert all(line.startswith(b"E4_Acc ") and line.count(b" ") == 4 for line in whole)


def test_a_connection_may_end_within_a_line(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp")
        client.until_lines("E4_Bvp", 2)
        server.close_within_line()
        client.until_closed()
        assert not client.data.pop().endswith(b"\n")
        assert len(client.data) == len(server.truth.samples("bvp").times)
        assert server.truth.unsent_count("bvp") == 1


@pytest.mark.parametrize("seconds", [3600.0, -3600.0])
def test_the_clock_of_the_pc_may_be_set(world: World, line_client: Any, seconds: float) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp acc")
        client.until_lines("E4_Acc", 3)
        server.jump_clock(seconds)
        client.until_lines("E4_Acc", 20)
        for word in ("E4_Bvp", "E4_Acc"):
            (jump,) = [step for step in np.diff(stamps(client, word)) if abs(step) > 1]
            assert jump == pytest.approx(seconds, abs=0.05)


def test_answers_are_refused_withheld_and_invented(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="")
        server.refuse_stream("gsr")
        assert client.ask("device_subscribe gsr ON").startswith("R device_subscribe gsr ERR ")
        assert client.ask("device_subscribe tmp ON") == "R device_subscribe tmp OK\n"
        server.withhold_reply("pause")
        client.send("pause ON")
        assert client.ask("device_list") == LISTED
        server.send_raw(b"R device_frobnicate OK\n")
        assert client.reply() == "R device_frobnicate OK\n"


def test_lists_may_be_empty_for_a_time(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        server.empty_list(inf)
        assert client.ask("device_list") == "R device_list 0\n"
        assert client.ask("device_discover_list") == "R device_discover_list 0\n"
        server.empty_list(0.1)
        eventually(lambda: client.ask("device_list") == LISTED)


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
