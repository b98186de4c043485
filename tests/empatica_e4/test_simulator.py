"""The virtual E4 server: its answers, its data, and what can befall both."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.devices.empatica_e4.simulator import NumberFormat
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.empatica_e4.steering import SteeredE4

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


def test_unbinding_closes_the_connection_to_the_byte(
    world: World, line_client: Any, vectors: Any
) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="")
        play(client, scenario(vectors, "disconnect_closes_tcp"))
        assert client.read() == b""
        with line_client(server.settings) as again:
            assert again.ask("device_list") == f"R device_list 1 | {ID} Empatica_E4\n"


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


def stamps(client: Any, word: str = "E4_Bvp") -> list[float]:
    return [line.stamp for line in client.lines(word)]


# The data of the virtual E4 server: rates, bursts, delays, stamps, and the truth.
STEPS_S = {
    "E4_Bvp": 1 / 63.997,
    "E4_Acc": 1 / 32,
    "E4_Gsr": 1 / 4,
    "E4_Temperature": 1 / 4,
}
# A stamp has steps of 10 us.
ROUNDING_S = 1.1e-5


def gather(client: Any, beats: int = 4) -> None:
    client.begin()
    client.until_lines("E4_Ibi", beats)


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
