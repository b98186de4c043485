"""The virtual E4 server: its answers, its data, and what can befall both."""

from __future__ import annotations

from typing import Any

import pytest

from biosensor_gateway.devices.empatica_e4.simulator import NumberFormat
from biosensor_gateway.simulation.world import World
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


@pytest.mark.parametrize(
    ("name", "automatic", "is_bound"),
    [("happy_path", True, False), ("manual_btle", False, False), ("second_binding", True, True)],
)
def test_a_conversation_is_the_same_to_the_byte(
    world: World, line_client: Any, vectors: Any, name: str, automatic: bool, is_bound: bool
) -> None:
    with (
        SteeredE4(world, automatic=automatic) as server,
        line_client(server.settings) as client,
    ):
        if is_bound:
            client.begin(streams="")
        play(client, scenario(vectors, name))


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


def test_numbers_are_written_as_in_the_vectors(vectors: dict[str, Any]) -> None:
    lines = [each["message"] for each in vectors["vectors"] if each["category"] == "data"]
    texts = [text for line in lines for text in line.split()[1:]]
    assert len(texts) > 15
    for text in texts:
        style = NumberFormat("," if "," in text else ".", "\u2212" if "\u2212" in text else "-")
        number = float(text.replace(",", ".").replace("\u2212", "-"))
        assert text == (style.stamp(number) if number > 1e9 else style.value(number))
