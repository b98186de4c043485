"""Boards beside each other, each by its own name, for all who know a device."""

from __future__ import annotations

from biosensor_common.naming import source_id, topic
from biosensor_gateway.agent.device_set import Device
from biosensor_gateway.agent.readiness import steady_streams
from biosensor_gateway.agent.status import AgentStatus
from biosensor_gateway.page.agent import Viewer
from biosensor_gateway.page.live import History
from biosensor_gateway.recording.xdf.expectation import by_devices
from tests.line_sensor.conftest import line_settings

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
