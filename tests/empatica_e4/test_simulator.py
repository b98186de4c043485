"""The virtual E4 server: what it answers, to whom, and how it writes numbers."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.empatica_e4.simulator import NumberFormat
from biosensor_gateway.devices.empatica_e4.simulator.wire import as_sent
from biosensor_gateway.simulation.world import World
from tests.empatica_e4.steering import SteeredE4

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
