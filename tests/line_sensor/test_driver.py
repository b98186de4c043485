"""Virtual boards under the supervisor, by each way, one and several."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, closing
from typing import Any

import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import GatewayError
from biosensor_common.naming import source_id, topic
from biosensor_gateway.agent.device_set import Device
from biosensor_gateway.agent.readiness import steady_streams
from biosensor_gateway.agent.status import AgentStatus
from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.line_sensor import driver as driver_module
from biosensor_gateway.devices.line_sensor.driver import DRIVER
from biosensor_gateway.devices.line_sensor.simulator import (
    OpenEarableLineSensor,
    SimulatedLineSensor,
    UdpLineSensor,
)
from biosensor_gateway.page.agent_client import Viewer
from biosensor_gateway.page.live_feed import History
from biosensor_gateway.recording.xdf.verdict import by_devices
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from biosensor_gateway.transports.tap import What
from tests.line_sensor.conftest import line_settings
from tests.rigs.driver_run import NotedSink, connected, streaming
from tests.rigs.polling import until

# Virtual boards under the supervisor, by each way; and what is said of lines that do not fit.


@asynccontextmanager
async def board_that_says(said: bytes) -> AsyncGenerator[str]:
    """Serve the same lines for ever."""

    is_over = asyncio.Event()

    async def tell(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with closing(writer):
            while not (writer.is_closing() or is_over.is_set()):
                writer.write(said)
                await asyncio.sleep(0.01)

    server = await asyncio.start_server(tell, "127.0.0.1", 0)
    try:
        yield f"socket://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        is_over.set()
        server.close()
        await server.wait_closed()


async def refusal(settings: dict[str, Any]) -> str:
    own = line_settings(**settings)
    made = DRIVER.make(own, NotedSink("line_sensor"))()
    try:
        with pytest.raises(GatewayError) as caught:
            await made.connect()
    finally:
        await made.close()
    (sentence,) = str(caught.value).splitlines()
    return sentence


@pytest.mark.parametrize(
    ("said", "fields", "words"),
    [
        (b"1;2\n", {}, "the line '1;2' has 1 value between commas, but columns names 2; it has as"),
        (b"1,2,3\n", {}, "the line '1,2,3' has 3 values between commas, but columns names 2"),
        (b"1,a\n", {}, "the line '1,a' has 'a' in column y, which is not a number"),
        (b"\x80\xfe\x90\n", {}, "is no text; does the device use baud_rate = 115200?"),
        (b'{"a":1}\n', {"format": "json"}, "has no key x, y; its keys are 'a'"),
        (b"12", {}, "bytes came without a line end"),
        (b"", {}, "nothing arrived for"),
    ],
)
async def test_lines_that_do_not_fit_are_told_with_one_of_them(
    said: bytes, fields: dict[str, Any], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not said.endswith(b"\n"):
        # In vain is waited for a whole line alone.
        monkeypatch.setattr(driver_module, "FIRST_LINE_LIMIT_S", 0.5)
    monkeypatch.setattr(driver_module, "MOST_BAD", 5)
    async with board_that_says(said) as port:
        sentence = await refusal({"port": port, "rate_hz": 100.0, **fields})
    assert sentence.startswith(f"{port}: ")
    assert words in sentence


async def test_a_bad_line_is_counted_said_once_and_harms_no_other(world: World) -> None:
    with capture_logs() as logs, SimulatedLineSensor(world) as device:
        async with streaming(device) as run:
            await until(run.sink.has(5, "acc"))
            for _ in range(3):
                device.apply(Fault(FaultKind.GARBAGE, 20.0))
                await run.goes_on(5, "acc")
            dropped = run.sink.dropped_bytes
    assert dropped == 3 * len(b"E (4711) wifi:" + bytes(20) + b"\r\n")
    told = [each["line"] for each in logs if each["event"] == "a line is left out"]
    assert len(told) == 1
    assert "is no text" in told[0]
    assert run.lost == {}


async def test_a_udp_port_that_somebody_has_is_said(world: World) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 0))
        number = taken.getsockname()[1]
        sentence = await refusal({"udp_port": number})
    assert sentence == (
        f"UDP port {number}: another program or device uses it; choose another number for both"
    )


async def test_an_empty_datagram_is_no_end(world: World) -> None:
    with UdpLineSensor(world) as device:
        async with streaming(device) as run:
            await until(run.sink.has(5, "acc"))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
                other.sendto(b"", ("127.0.0.1", device.settings["udp_port"]))
            await run.goes_on(5, "acc")
            assert run.supervisor.connections == 1


async def test_lines_that_come_when_they_come_are_not_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(driver_module, "FIRST_LINE_LIMIT_S", 0.1)
    async with board_that_says(b"") as port:
        made = DRIVER.make(line_settings(port=port), NotedSink("line_sensor"))()
        await made.connect()
        assert made.silence_limit_s == float("inf")
        await made.close()


async def test_a_device_that_waits_for_a_command_gets_it() -> None:
    heard = asyncio.get_running_loop().create_future()

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with closing(writer):
            heard.set_result(await reader.readline())
            writer.write(b"0,0\n1,2\n")
            await reader.read()

    server = await asyncio.start_server(answer, "127.0.0.1", 0)
    port = f"socket://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    settings = line_settings(port=port, rate_hz=1.0, start_command="go\n")
    made = DRIVER.make(settings, NotedSink("line_sensor"))()
    await made.connect()
    assert await heard == b"go\n"
    await made.close()
    server.close()
    await server.wait_closed()


async def test_connecting_again_finds_the_port_free(world: World) -> None:
    with UdpLineSensor(world) as device:
        for _ in range(2):
            async with connected(device):
                pass


async def test_when_the_app_ends_the_values_they_are_asked_for_again(world: World) -> None:
    with OpenEarableLineSensor(world) as device:
        async with streaming(device) as run:
            await until(run.sink.has(10, "acc"))
            world.call(device.app.end_values)
            await until(lambda: "has stopped sending Chest" in run.error)
            await run.goes_on(10, "acc")
        assert run.supervisor.connections == 2


@pytest.mark.parametrize(
    ("options", "fields", "words"),
    [
        ({"wearables": ()}, {}, "no wearable is connected to it; connect yours there"),
        ({}, {"openearable_wearable": "Other"}, "only OpenEarable-0001 is connected to it"),
        ({"wearables": ("A", "B")}, {}, "A, B are connected to it; set openearable_wearable to"),
        ({}, {"openearable_sensor": "Arm"}, "has no sensor Arm; it has Chest"),
        ({"exponent": -9}, {}, "the time of Chest is in ns, but columns says [us]"),
    ],
)
async def test_what_the_app_does_not_have_is_told(
    world: World, options: dict[str, Any], fields: dict[str, Any], words: str
) -> None:
    with OpenEarableLineSensor(world, **options) as device:
        assert words in await refusal({**device.settings, **fields})


async def test_the_wearable_of_two_is_taken_by_its_name_and_a_refusal_is_told(
    world: World,
) -> None:
    with OpenEarableLineSensor(world, wearables=("A", "B")) as device:
        named = {"openearable_wearable": "B"}
        async with connected(device, **named):
            pass
        device.app.refuses = True
        said = await refusal({**device.settings, **named})
        assert "refuses list_connected: Bad state: No permission" in said


# Boards beside each other, each by its own name, for all who know a device.
STRAP = line_settings(name="chest_strap", columns=["force [N]", "temp/t"], rate_hz=50.0,
                      irregular=["temp"])  # fmt: skip
GLOVE = line_settings(name="glove", columns=["a/x", "a/y"], rate_hz=100.0, udp_port=5006)


async def test_topics_and_streams_have_each_board_s_name() -> None:
    strap, glove = Device.from_settings(STRAP), Device.from_settings(GLOVE)
    assert (strap.name, glove.name) == ("chest_strap/1", "glove/1")
    assert topic(strap.sink.identity, "data") == "biosensors/chest_strap/data"
    assert topic(glove.sink.identity, "a") == "biosensors/glove/a"
    assert [each.source_id for each in by_devices([STRAP, GLOVE])] == [
        "chest_strap-1-data",
        "chest_strap-1-temp",
        "glove-1-a",
    ]


async def test_the_status_says_what_the_settings_declare() -> None:
    status = Device.from_settings(STRAP).status()
    assert [each.data_name for each in status.declared] == ["data", "temp"]
    assert (status.declared[0].labels, status.declared[0].units) == (["force"], ["N"])
    # As whoever waits for the agent reads it, before the board was ever connected.
    assert steady_streams(status.model_dump(), frozenset()) == ("chest_strap-1-data",)


async def test_the_page_shows_a_board_by_what_its_settings_declare() -> None:
    device = Device.from_settings(STRAP)
    device.sink.open(device.sink.info, {})
    try:
        status = AgentStatus(devices=[device.status()], lsl_time=1.0)
        (view,) = Viewer(History()).devices(status)
    finally:
        device.sink.close()
    assert view.title == "chest_strap"
    shown = view.streams[source_id(device.sink.identity, "data")]
    assert (shown.topic, shown.units) == ("/biosensors/chest_strap/data", ["N"])


WHO = ("Renate", "Eva", "48.13743", "4807.038", "4711", "iPhone", "01131.000")
PHONE = {
    "deviceName": "Renates iPhone",
    "name": "Eva",
    "serial": "00004711",
    "athlete": {"name": "J\u00fcrgen", "first": "Eva"},
    "acc": [0.0437, -0.9723],
    "gsr": "4.8049",
    "error": {"message": "Renates iPhone is gone"},
    "location": {"lat": 48.13743, "Longitude": 11.57549},
}
GPS = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
CSV = b"9,90000,-0.9723,0.0437,0.2369\r\n"


@pytest.mark.parametrize("packets", [1, 7])
def test_of_a_capture_only_what_tells_who_and_where_is_replaced(packets: int) -> None:
    said = json.dumps(PHONE).encode() + b"\n" + GPS + CSV
    size = -(-len(said) // packets)
    pieces = [said[at : at + size] for at in range(0, len(said), size)]
    events = [Event(t=0.0, link=0, what=What.CAME, data=each.hex()) for each in pieces]
    told = b"".join(
        each.bytes for each in Redaction(lambda _: False, DRIVER.identifiers).of(events, [])
    )
    line, *rest = told.splitlines(keepends=True)
    assert [each for each in WHO if each in told.decode()] == []
    read = json.loads(line)
    assert (read["acc"], read["gsr"], list(read)) == (PHONE["acc"], PHONE["gsr"], list(PHONE))
    assert rest[1] == CSV
    assert rest[0].startswith(b"$GPGGA,123519,4")
    assert rest[0].endswith(b",E,1,08,0.9,545.4,M,46.9,M,,*47\r\n")
