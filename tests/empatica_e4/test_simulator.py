"""The virtual E4 server: its answers, its data, and what can befall both."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.empatica_e4.simulator import NumberFormat, Timing
from biosensor_gateway.devices.empatica_e4.simulator.e4 import damaged_line
from biosensor_gateway.devices.empatica_e4.simulator.wire import as_sent
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.empatica_e4.steering import SteeredE4
from tests.rigs.virtual_time import pause

# The virtual E4 server: what it answers, to whom, and how it writes numbers.

ID = "9ff167"
NOT_BOUND = "ERR You are not connected to any device\n"


def scenario(vectors: dict[str, Any], name: str) -> list[str]:
    (found,) = (each for each in vectors["scenarios"] if each["name"] == name)
    steps: list[str] = found["steps"]
    return steps


def play(client: Any, steps: list[str]) -> None:
    """Say what the client says and expect the server's lines to the last byte."""
    for step in steps:
        if step.startswith("> "):
            client.send(step[2:])
        elif step.endswith("..."):
            line = client.read()
            assert line.startswith(step[2:-3].encode())
            assert line.endswith(b"\r\n")
        elif step.startswith("< "):
            assert client.read() == step[2:].encode() + b"\n"


def test_the_happy_path_to_the_byte(world: World, line_client: Any, vectors: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        play(client, scenario(vectors, "happy_path"))


def test_the_manual_path_to_the_byte(world: World, line_client: Any, vectors: Any) -> None:
    with (
        SteeredE4(world, automatic=False) as server,
        line_client(server.settings) as client,
    ):
        play(client, scenario(vectors, "manual_btle"))


def test_a_wristband_of_another_owner_to_the_byte(
    world: World, line_client: Any, vectors: Any
) -> None:
    with (
        SteeredE4(world, device_id="7a3166", allowed=False) as server,
        line_client(server.settings) as client,
    ):
        play(client, scenario(vectors, "not_allowed"))
        assert client.ask("device_list") == "R device_list 0\n"
        refusal = client.ask("device_connect_btle 7a3166 208")
        assert refusal == (
            "R device_connect_btle ERR The device is not registered with the API key\n"
        )
        server.allow()
        assert client.ask("device_list") == "R device_list 1 | 7a3166 Empatica_E4\n"


def test_a_second_binding_of_one_connection_to_the_byte(
    world: World, line_client: Any, vectors: Any
) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="")
        play(client, scenario(vectors, "second_binding"))


def test_one_wristband_may_have_several_clients(
    world: World, line_client: Any, vectors: Any
) -> None:
    with (
        SteeredE4(world) as server,
        line_client(server.settings) as first,
        line_client(server.settings) as second,
    ):
        first.begin(streams="acc")
        play(second, scenario(vectors, "bound_elsewhere"))
        assert second.ask("device_subscribe bvp ON") == "R device_subscribe bvp OK\n"
        first.until_lines("E4_Acc", 5)
        second.until_lines("E4_Bvp", 5)
        assert not first.raw("E4_Bvp")
        assert not second.raw("E4_Acc")
        second.ask("pause ON")
        paused_at = len(second.data)
        first.until_lines("E4_Acc", 20)
        assert second.ask("device_list") == f"R device_list 1 | {ID} Empatica_E4\n"
        assert len(second.data) == paused_at
        assert second.ask("pause OFF") == "R pause OFF\n"
        second.until_lines("E4_Bvp", paused_at + 5)


def test_unbinding_closes_the_connection_to_the_byte(
    world: World, line_client: Any, vectors: Any
) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="")
        play(client, scenario(vectors, "disconnect_closes_tcp"))
        assert client.read() == b""
        with line_client(server.settings) as again:
            assert again.ask("device_list") == f"R device_list 1 | {ID} Empatica_E4\n"


@pytest.mark.parametrize("end", ["\r\n", "\n"])
def test_requests_end_either_way_and_come_in_any_pieces(
    world: World, line_client: Any, end: str
) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        for piece in ("devi", "ce_list", *end, f"{end}device_connect {ID.upper()}{end}pau"):
            client.socket.sendall(piece.encode())
        assert client.read() == f"R device_list 1 | {ID} Empatica_E4\n".encode()
        assert client.read() == b"R device_connect OK\n"
        assert client.ask("se ON", end) == "R pause ON\n"
        assert server.requests == ("device_list", f"device_connect {ID.upper()}", "pause ON")


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("device_subscribe bvp ON", NOT_BOUND),
        ("pause ON", NOT_BOUND),
        ("device_disconnect", "ERR No connected device.\n"),
        ("device_connect ffffff", "ERR The device requested for connection is not available.\n"),
        ("device_connect", "ERR The device requested for connection is not available.\n"),
        ("device_connect_btle ffffff", "ERR The device has not been discovered yet\n"),
        ("device_disconnect_btle ffffff", "ERR The device is not connected over btle\n"),
        ("server_status", "OK\n"),
        ("make_coffee", "ERR Unknown command\n"),
    ],
)
def test_what_cannot_be_done_is_an_error(
    world: World, line_client: Any, request_: str, answer: str
) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        assert client.ask(request_) == f"R {request_.split(maxsplit=1)[0]} {answer}"


@pytest.mark.parametrize("stream", ["hr", "temp", "battery", "eeg"])
def test_only_the_words_of_the_protocol_can_be_subscribed_to(
    world: World, line_client: Any, stream: str
) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin()
        answer = client.ask(f"device_subscribe {stream} ON")
        assert answer.startswith(f"R device_subscribe {stream} ERR ")
        assert client.ask("pause maybe").startswith("R pause ERR ")


def test_a_subscription_ends(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="acc bvp")
        client.until_lines("E4_Acc", 1)
        assert client.ask("device_subscribe acc OFF") == "R device_subscribe acc OK\n"
        count = len(client.raw("E4_Acc"))
        client.until_lines("E4_Bvp", 40)
        assert len(client.raw("E4_Acc")) == count


def test_several_wristbands_of_one_server(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, others=("CC34CD",)) as server,
        line_client(server.settings) as first,
        line_client(server.settings_of("CC34CD")) as second,
    ):
        listed = f"R device_list 2 | {ID} Empatica_E4 | CC34CD Empatica_E4\n"
        assert first.ask("device_list") == listed
        first.begin(streams="bvp")
        second.begin("cc34cd", "bvp")
        for client, device_id in ((first, ID), (second, "CC34CD")):
            client.until_lines("E4_Bvp", 20)
            values = [line.values for line in client.lines("E4_Bvp")]
            sent = server.truth_of(device_id).samples("bvp").values
            assert [tuple(row) for row in sent[: len(values)]] == values
        assert (
            server.truth.samples("bvp").values[0]
            != server.truth_of("CC34CD").samples("bvp").values[0]
        )


def test_a_lost_wristband_is_replaced_by_another_on_the_same_connection(
    world: World, line_client: Any
) -> None:
    with (
        SteeredE4(world, others=("cc34cd",)) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bvp")
        server.turn_off()
        assert client.reply() == f"R device {ID} turned off via button\n"
        client.begin("cc34cd", "acc")
        client.until_lines("E4_Acc", 3)
        assert server.truth.samples("acc").times.size == 0


def test_a_client_ends_a_radio_link_and_begins_another(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        assert client.ask(f"device_disconnect_btle {ID}") == "R device_disconnect_btle OK\n"
        assert client.ask("device_list") == "R device_list 0\n"
        found = f"R device_discover_list 1 | {ID} Empatica_E4 allowed\n"
        assert client.ask("device_discover_list") == found
        wrong = client.ask(f"device_connect_btle {ID} 255")
        assert wrong == "R device_connect_btle ERR could not connect device over BTLE\n"
        assert client.ask(f"device_connect_btle {ID} 0") == "R device_connect_btle OK\n"
        client.begin(streams="bvp")
        client.until_lines("E4_Bvp", 2)


VALUES = [
    (33.75, "33,75"),
    (0.0832364, "0,0832364"),
    (21.54169, "21,54169"),
    (9.536743e-07, "9,536743E-07"),
    (1e-05, "1E-05"),
    (0.0001, "0,0001"),
    (-12.0, "-12"),
    (-0.0, "0"),
    (0.0, "0"),
    (1.0, "1"),
    (0.73, "0,73"),
    (1234567.0, "1234567"),
    (12345678.0, "1,234568E+07"),
    (0.1 + 0.2, "0,3"),
]
STAMPS = [
    (1680442024.64479, "1680442024,64479"),
    (1680442024.7300001, "1680442024,73"),
    (1680442024.0, "1680442024"),
    (1680442031.502134, "1680442031,50213"),
]


@pytest.mark.parametrize(("number", "text"), VALUES)
def test_values_have_seven_digits(number: float, text: str) -> None:
    assert NumberFormat().value(number) == text
    assert NumberFormat(".").value(number) == text.replace(",", ".")
    assert NumberFormat(",", "\u2212").value(number) == text.replace("-", "\u2212")


@pytest.mark.parametrize(("number", "text"), STAMPS)
def test_stamps_have_fifteen_digits(number: float, text: str) -> None:
    assert NumberFormat().stamp(number) == text
    assert NumberFormat(",").with_other_mark().stamp(number) == text.replace(",", ".")


def test_numbers_are_written_as_in_the_vectors(vectors: dict[str, Any]) -> None:
    lines = [each["message"] for each in vectors["vectors"] if each["category"] == "data"]
    texts = [text for line in lines for text in line.split()[1:]]
    assert len(texts) > 15
    for text in texts:
        style = NumberFormat("," if "," in text else ".", "\u2212" if "\u2212" in text else "-")
        number = float(text.replace(",", ".").replace("\u2212", "-"))
        assert text == (style.stamp(number) if number > 1e9 else style.value(number))


@given(st.floats(-1e6, 1e6))
def test_what_is_written_is_what_is_noted(number: float) -> None:
    text = NumberFormat().value(number).replace(",", ".")
    assert float(text) == as_sent(number)
    assert as_sent(as_sent(number)) == as_sent(number)
    assert as_sent(number) == pytest.approx(np.float32(number), rel=1e-6, abs=1e-37)


@pytest.mark.parametrize(
    ("mark", "minus"), [(",", "-"), (".", "-"), (",", "\u2212")], ids=["comma", "dot", "U+2212"]
)
def test_lines_follow_the_locale(world: World, line_client: Any, mark: str, minus: str) -> None:
    with (
        SteeredE4(world, style=NumberFormat(mark, minus)) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bvp acc")
        client.until_lines("E4_Bvp", 30)
        text = b"".join(client.data).decode()
    assert mark in text
    assert {",": ".", ".": ","}[mark] not in text
    assert minus in text
    assert {"-": "\u2212", "\u2212": "-"}[minus] not in text


def test_stopping_closes_connections_and_gives_the_port_back(
    world: World, line_client: Any
) -> None:
    with ExitStack() as stack:
        settings = stack.enter_context(SteeredE4(world)).settings
        with line_client(settings) as client:
            client.begin()
            stack.close()
            client.until_closed()
    with pytest.raises(ConnectionRefusedError):
        line_client(settings)


# What can befall the virtual E4 server: radio, connections, the process.
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


# What can befall single lines and answers of the virtual E4 server.
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


# The data of the virtual E4 server: rates, bursts, delays, stamps, and the truth.
STEPS_S = {
    "E4_Bvp": 1 / 63.997,
    "E4_Acc": 1 / 32,
    "E4_Gsr": 1 / 4,
    "E4_Temperature": 1 / 4,
}
DATA_NAMES = {
    "E4_Bvp": "bvp",
    "E4_Acc": "acc",
    "E4_Gsr": "gsr",
    "E4_Temperature": "st",
    "E4_Hr": "hr",
    "E4_Ibi": "ibi",
    "E4_Battery": "bat",
}
# A stamp has steps of 10 us.
ROUNDING_S = 1.1e-5


def gather(client: Any, beats: int = 4) -> None:
    client.begin()
    client.until_lines("E4_Ibi", beats)


def declared(word: str, values: tuple[float, ...]) -> list[float]:
    """Values of a line in the units of the declaration."""
    match word:
        case "E4_Acc":
            return [value / 64 for value in values]
        case "E4_Battery":
            return [100 * values[0]]
        case "E4_Gsr":
            return [values[0] or np.nan]
        case _:
            return list(values)


def assert_equals_truth(server: SteeredE4, client: Any, *words: str) -> None:
    """What a client read is what was noted, from the first line on and in order."""
    for word in words or DATA_NAMES:
        lines = client.lines(word)
        assert lines, word
        truth = server.truth.samples(DATA_NAMES[word]).values[: len(lines)]
        np.testing.assert_allclose([declared(word, line.values) for line in lines], truth)


def test_stamps_count_samples_by_the_nominal_rate(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, jitter_s=0.05, drift_ppm=200) as server,
        line_client(server.settings) as client,
    ):
        client.begin()
        client.until_lines("E4_Gsr", 12)
    for word, step_s in STEPS_S.items():
        stamps = [line.stamp for line in client.lines(word)]
        assert len(stamps) >= 12
        assert all(abs(b - a - step_s) < ROUNDING_S for a, b in pairwise(stamps)), word


def test_the_reference_is_the_begin_of_the_radio_link(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, automatic=False) as server,
        line_client(server.settings) as first,
        line_client(server.settings) as second,
    ):
        first.ask("device_connect_btle 9ff167")
        first.begin(streams="bvp")
        first.until_lines("E4_Bvp", 100)
        second.begin(streams="bvp acc")
        second.until_lines("E4_Acc", 1)
        step_s = STEPS_S["E4_Bvp"]
        begin = first.lines("E4_Bvp")[0].stamp
        numbers = (second.lines("E4_Bvp")[0].stamp - begin) / step_s
        assert numbers > 90
        assert numbers == pytest.approx(round(numbers), abs=2e-3)


def test_conductance_and_temperature_come_in_bursts(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp gsr tmp")
        client.until_lines("E4_Temperature", 18)
    words = [line.split(maxsplit=1)[0].decode() for line in client.data]
    for word in ("E4_Gsr", "E4_Temperature"):
        places = [place for place, each in enumerate(words) if each == word]
        runs = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
        assert [len(run) for run in runs[:-1]] == [6] * (len(runs) - 1)
        assert len(runs) >= 3


def test_beats_come_late_and_the_rate_before_the_interval(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        gather(client)
        rates, intervals = client.lines("E4_Hr"), client.lines("E4_Ibi")
        newest_bvp = client.lines("E4_Bvp")[-1].stamp
    assert 5.5 < newest_bvp - intervals[-1].stamp < 5.7
    order = [line[:6] for line in client.data if line[:6] in (b"E4_Hr ", b"E4_Ibi")]
    assert order[::2] == [b"E4_Hr "] * len(intervals)
    assert order[1::2] == [b"E4_Ibi"] * len(intervals)
    for rate, interval in zip(rates, intervals, strict=True):
        assert rate.stamp == interval.stamp
        assert rate.values[0] * interval.values[0] == pytest.approx(60, abs=1e-4)
    for before, after in pairwise(intervals):
        assert after.stamp - before.stamp == pytest.approx(after.values[0], abs=2 * ROUNDING_S)


def test_beats_are_those_of_the_wearer(world: World, line_client: Any) -> None:
    wearer = Wearer(1, heart_rate_bpm=90)
    with (
        SteeredE4(world, timing=Timing(beat_delay_s=0.0), wearer=wearer) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="ibi")
        client.until_lines("E4_Ibi", 8)
        rates = [line.values[0] for line in client.lines("E4_Hr")]
    # Swing and steps of 1/64 s.
    assert all(90 * 0.94 < rate < 90 * 1.07 for rate in rates)


def test_bvp_may_come_later_than_conductance(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, timing=Timing(bvp_delay_s=0.065)) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bvp gsr")
        client.until_lines("E4_Gsr", 12)
        newest = client.lines("E4_Gsr")[11].stamp
        index = client.data.index(client.raw("E4_Gsr")[11])
        bvp = [line for line in client.data[:index] if line.startswith(b"E4_Bvp")]
    ahead = newest - float(bvp[-1].split()[1].replace(b",", b"."))
    assert 0.045 < ahead < 0.085


def test_the_charge_comes_at_its_interval(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, timing=Timing(battery_interval_s=0.5)) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bat")
        client.until_lines("E4_Battery", 3)
        server.apply(Fault(FaultKind.LOW_BATTERY, 4))
        client.until(lambda: client.lines("E4_Battery")[-1].values == (0.04,))
        lines = client.lines("E4_Battery")
        assert_equals_truth(server, client, "E4_Battery")
    assert lines[0].values == (0.82,)
    for before, after in pairwise(lines):
        assert after.stamp - before.stamp == pytest.approx(0.5, abs=2 * ROUNDING_S)


def test_a_button_press_is_a_line_without_value(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp tag")
        client.until_lines("E4_Bvp", 5)
        before = LSL_CLOCK()
        server.press_button()
        after = LSL_CLOCK()
        client.until_lines("E4_Tag", 1)
        (tag,) = client.lines("E4_Tag")
        (truth,) = server.truth.samples("tag").times
        assert tag.values == ()
        assert before <= truth <= after
        # Stamps and truth have the same distance in both streams: there is no drift.
        first = client.lines("E4_Bvp")[0].stamp - server.truth.samples("bvp").times[0]
        assert tag.stamp - truth == pytest.approx(first, abs=1e-4)


def test_the_oscillator_drifts_against_the_stamps(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, drift_ppm=5000) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bvp acc")
        client.until_lines("E4_Bvp", 130)
        for word, name in (("E4_Bvp", "bvp"), ("E4_Acc", "acc")):
            stamps = np.array([line.stamp for line in client.lines(word)])
            times = server.truth.samples(name).times[: len(stamps)]
            speed = (stamps[-1] - stamps[0]) / (times[-1] - times[0])
            assert speed == pytest.approx(1.005, abs=1e-4)
        server.apply(Fault(FaultKind.DRIFT, -5000))
        # Sent by now, whether the client has read it or not.
        count = len(server.truth.samples("bvp").times) + 10
        client.until_lines("E4_Bvp", count + 130)
        stamps = np.array([line.stamp for line in client.lines("E4_Bvp")[count:]])
        times = server.truth.samples("bvp").times[count : count + len(stamps)]
        speed = (stamps[-1] - stamps[0]) / (times[-1] - times[0])
        assert speed == pytest.approx(0.995, abs=1e-4)


def test_nothing_arrives_before_it_is_measured_nor_out_of_order(
    world: World, line_client: Any
) -> None:
    with (
        SteeredE4(world, jitter_s=0.1) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bvp acc gsr")
        arrivals: list[float] = []
        while len(client.raw("E4_Bvp")) < 100:
            line = client.read()
            if line.startswith(b"E4_Bvp"):
                arrivals.append(LSL_CLOCK())
        stamps = [line.stamp for line in client.lines("E4_Bvp")][-len(arrivals) :]
        times = server.truth.samples("bvp").times[: len(client.raw("E4_Bvp"))][-len(arrivals) :]
    assert stamps == sorted(stamps)
    assert all(arrival >= time for arrival, time in zip(arrivals, times, strict=True))


def test_equal_wearers_measure_equal_things(world: World, line_client: Any) -> None:
    wearer = Wearer(4)
    t = np.arange(0, 30.0, 0.01)
    with SteeredE4(world, seed=4) as server, line_client(server.settings) as client:
        client.begin(streams="tmp")
        client.until_lines("E4_Temperature", 6)
        readings = [line.values[0] for line in client.lines("E4_Temperature")]
    true = np.rint(wearer.skin_temperature_c(t) * 50) / 50
    assert set(np.round(readings, 4)) <= set(np.round(true, 4))
