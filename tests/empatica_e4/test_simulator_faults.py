"""What can befall the virtual E4 server: radio, connections, answers, single lines."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.empatica_e4.simulator import SimulatedE4
from biosensor_gateway.devices.empatica_e4.simulator.garbage import damaged_line
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World

ID = "9ff167"
LISTED = f"R device_list 1 | {ID} Empatica_E4\n"
LOST = f"R connection lost to device {ID}\n"
BACK = f"R connection re-established to device {ID}\n"
FOREVER = float("inf")
DEADLINE_S = 20.0
STEP_S = 1 / 63.997


def eventually(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)


def until_accepted(line_client: Any, server: SimulatedE4) -> Any:
    """Connect as soon as the port is open."""
    deadline = time.monotonic() + DEADLINE_S
    while True:
        try:
            return line_client(server.settings)
        except ConnectionRefusedError:
            assert time.monotonic() < deadline, "it did not open"
            time.sleep(0.02)


def assert_broken_off(client: Any) -> None:
    with pytest.raises(ConnectionResetError):
        client.until_closed()


def stamps(client: Any, word: str = "E4_Bvp") -> list[float]:
    return [line.stamp for line in client.lines(word)]


def test_a_lost_radio_link_is_told_and_comes_back_with_a_new_reference(
    world: World, line_client: Any
) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp")
        client.until_lines("E4_Bvp", 10)
        server.apply(Fault(FaultKind.DROP, FOREVER))
        assert client.reply() == LOST
        before = len(client.data)
        assert client.ask("device_list") == "R device_list 0\n"
        assert client.ask("device_discover_list") == "R device_discover_list 0\n"
        eventually(lambda: server.truth.unsent_count("bvp") >= 20)
        server.clear(FaultKind.DROP)
        assert client.reply() == BACK
        assert len(client.data) == before
        # Subscriptions have survived.
        client.until_lines("E4_Bvp", before + 30)
        steps = np.diff(stamps(client)) / STEP_S
        assert steps[before - 1] > 20
        assert abs(np.delete(steps, before - 1) - 1).max() < 2e-3
        assert len(server.truth.samples("bvp").times) >= len(client.data)


def test_a_radio_link_that_is_lost_for_a_time_comes_back_by_itself(
    world: World, line_client: Any
) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp")
        server.apply(Fault(FaultKind.DROP, 0.2))
        assert client.reply() == LOST
        assert client.reply() == BACK
        assert client.ask("device_list") == LISTED


def test_without_automatic_connections_a_client_connects_anew(
    world: World, line_client: Any
) -> None:
    with (
        SimulatedE4(world, automatic=False) as server,
        line_client(server.settings) as client,
        line_client(server.settings) as other,
    ):
        client.ask(f"device_connect_btle {ID} 208")
        client.begin(streams="bvp")
        server.apply(Fault(FaultKind.DROP, FOREVER))
        assert client.reply() == LOST
        too_early = other.ask(f"device_connect_btle {ID} 208")
        assert too_early == "R device_connect_btle ERR The device has not been discovered yet\n"
        server.clear(FaultKind.DROP)
        found = f"R device_discover_list 1 | {ID} Empatica_E4 allowed\n"
        assert other.ask("device_discover_list") == found
        assert other.ask(f"device_connect_btle {ID} 208") == "R device_connect_btle OK\n"
        assert client.reply() == BACK
        client.until_lines("E4_Bvp", 20)


def test_a_wristband_that_was_given_no_patience_is_off_once_it_is_lost(
    world: World, line_client: Any
) -> None:
    with (
        SimulatedE4(world, automatic=False) as server,
        line_client(server.settings) as client,
    ):
        client.ask(f"device_connect_btle {ID}")
        client.begin(streams="bvp")
        server.apply(Fault(FaultKind.DROP, 0.0))
        assert client.reply() == LOST
        assert client.ask("device_discover_list") == "R device_discover_list 0\n"
        server.turn_on()
        assert client.ask("device_discover_list").endswith("allowed\n")


def test_a_wristband_that_is_turned_off_is_told_and_unbound(world: World, line_client: Any) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp")
        client.until_lines("E4_Bvp", 3)
        server.turn_off()
        assert client.reply() == f"R device {ID} turned off via button\n"
        assert client.ask("device_list") == "R device_list 0\n"
        assert client.ask(f"device_connect {ID}").startswith("R device_connect ERR ")
        server.turn_on()
        assert client.ask("device_list") == LISTED
        assert client.ask("pause ON") == "R pause ERR You are not connected to any device\n"
        before = len(client.data)
        client.begin(streams="bvp")
        client.until_lines("E4_Bvp", before + 3)


def test_a_stalled_server_says_nothing_and_reads_nothing(world: World, line_client: Any) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp")
        client.until_lines("E4_Bvp", 3)
        server.apply(Fault(FaultKind.STALL, FOREVER))
        client.send("device_list")
        with line_client(server.settings) as late:
            late.send("device_list")
            eventually(lambda: server.truth.unsent_count("bvp") >= 20)
            assert "device_list" not in server.requests
            sent = len(server.truth.samples("bvp").times)
            server.clear(FaultKind.STALL)
            assert late.reply() == LISTED
        assert client.reply() == LISTED
        client.until_lines("E4_Bvp", sent + 10)
        steps = np.rint(np.diff(stamps(client)) / STEP_S)
        assert sum(steps - 1) == server.truth.unsent_count("bvp")
        assert np.count_nonzero(steps != 1) == 1


def test_garbage_stands_between_lines(world: World, line_client: Any) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
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


def test_a_refusing_server_breaks_off_and_binds_nobody(world: World, line_client: Any) -> None:
    with SimulatedE4(world) as server:
        with line_client(server.settings) as client:
            client.begin()
            server.apply(Fault(FaultKind.REFUSE, FOREVER))
            assert_broken_off(client)
        with line_client(server.settings) as again:
            assert again.ask("device_list") == LISTED
            assert again.ask(f"device_connect {ID}").startswith("R device_connect ERR ")
            server.clear(FaultKind.REFUSE)
            again.begin()


def test_late_answers_still_come_and_after_data(world: World, line_client: Any) -> None:
    with SimulatedE4(world) as server:
        with line_client(server.settings) as client:
            client.begin(streams="bvp")
            server.apply(Fault(FaultKind.LATE, 0.3))
            assert_broken_off(client)
        with line_client(server.settings) as again:
            again.begin(streams="bvp")
            assert again.data
            server.clear(FaultKind.LATE)
            again.until_lines("E4_Bvp", 3)


def test_a_restart_resets_refuses_and_comes_up_under_another_locale(
    world: World, line_client: Any
) -> None:
    with SimulatedE4(world) as server:
        with line_client(server.settings) as client:
            client.begin(streams="bvp")
            client.until_lines("E4_Bvp", 5)
            server.apply(Fault(FaultKind.RESTART, FOREVER))
            assert_broken_off(client)
            with pytest.raises(ConnectionRefusedError):
                line_client(server.settings)
        server.clear(FaultKind.RESTART)
        with line_client(server.settings) as again:
            assert again.ask("device_list") == LISTED
            again.begin(streams="bvp")
            again.until_lines("E4_Bvp", 20)
        assert b"," in b"".join(client.data)
        assert b"," not in b"".join(again.data)
        assert b"." in b"".join(again.data)
        numbers = (stamps(again)[0] - stamps(client)[0]) / STEP_S
        assert numbers != pytest.approx(round(numbers), abs=1e-4)


def test_a_restart_ends_by_itself(world: World, line_client: Any) -> None:
    with SimulatedE4(world) as server:
        server.apply(Fault(FaultKind.RESTART, 0.2))
        with until_accepted(line_client, server) as client:
            assert client.ask("device_list") == LISTED


def test_a_restarted_server_without_automatic_connections_has_none(
    world: World, line_client: Any
) -> None:
    with SimulatedE4(world, automatic=False) as server:
        with line_client(server.settings) as client:
            client.ask(f"device_connect_btle {ID} 0")
        server.apply(Fault(FaultKind.RESTART, 0.1))
        with until_accepted(line_client, server) as again:
            assert again.ask("device_list") == "R device_list 0\n"


def test_packets_that_are_lost_on_the_radio_leave_no_gap_in_the_stamps(
    world: World, line_client: Any
) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp")
        client.until_lines("E4_Bvp", 20)
        server.lose_packets(0.5, seconds=1.0)
        eventually(lambda: server.truth.unsent_count("bvp") >= 20)
        client.until_lines("E4_Bvp", 120)
        lost = server.truth.unsent_count("bvp")
        assert 15 < lost < 50
        times = server.truth.samples("bvp").times[: len(client.data)]
        assert abs(np.diff(stamps(client)) / STEP_S - 1).max() < 2e-3
        late_s = (times - times[0]) - (np.array(stamps(client)) - stamps(client)[0])
        assert late_s[-1] == pytest.approx(lost * STEP_S, abs=1e-3)


def test_lines_are_doubled_glued_and_torn(world: World, line_client: Any) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
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
    with SimulatedE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="acc")
        server.tear_line(0.3)
        pieces: list[bytes] = []
        while not pieces or pieces[-1].endswith(b"\r\n"):
            pieces.append(client.socket.recv(4096))
        pieces.append(client.socket.recv(4096))
        whole = (pieces[-2] + pieces[-1]).splitlines()
        assert all(line.startswith(b"E4_Acc ") and line.count(b" ") == 4 for line in whole)


def test_a_connection_may_end_within_a_line(world: World, line_client: Any) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp")
        client.until_lines("E4_Bvp", 2)
        server.close_within_line()
        client.until_closed()
        assert not client.data.pop().endswith(b"\n")
        assert len(client.data) == len(server.truth.samples("bvp").times)
        assert server.truth.unsent_count("bvp") == 1


@pytest.mark.parametrize("seconds", [3600.0, -3600.0])
def test_the_clock_of_the_pc_may_be_set(world: World, line_client: Any, seconds: float) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp acc")
        client.until_lines("E4_Acc", 3)
        server.jump_clock(seconds)
        client.until_lines("E4_Acc", 20)
        for word in ("E4_Bvp", "E4_Acc"):
            (jump,) = [step for step in np.diff(stamps(client, word)) if abs(step) > 1]
            assert jump == pytest.approx(seconds, abs=0.05)


def test_answers_are_refused_withheld_and_invented(world: World, line_client: Any) -> None:
    with SimulatedE4(world) as server, line_client(server.settings) as client:
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
    with SimulatedE4(world) as server, line_client(server.settings) as client:
        server.empty_list(0.3)
        assert client.ask("device_list") == "R device_list 0\n"
        assert client.ask("device_discover_list") == "R device_discover_list 0\n"
        eventually(lambda: client.ask("device_list") == LISTED)


def test_a_client_that_does_not_read_loses_nothing_for_long_and_blocks_nobody(
    world: World, line_client: Any
) -> None:
    with (
        SimulatedE4(world) as server,
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
    with SimulatedE4(world) as server:
        with line_client(server.settings) as client:
            client.begin()
            server.close_connections()
            assert_broken_off(client)
        eventually(lambda: server.client_count == 0)
        with line_client(server.settings) as again:
            again.begin()
