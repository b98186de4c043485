"""What the API says of the agent is what ``status --json`` says, by the same models."""

from __future__ import annotations

import json
import time
from typing import Any, cast

import pytest

from biosensor_gateway.agent.status import AgentStatus, DeviceFacts, StreamStatus
from tests.page.conftest import DEADLINE_S, Server

pytestmark = pytest.mark.nightly

Entries = dict[str, Any]
# Counted, or measured again each second; all else stays the same while all is well.
CHANGING = {
    *("written", "lsl_time"),
    *("offset_s", "drift_ppm", "residual_rms_s", "observations", "newest_s"),
    *("pushed", "waited", "last_stamp", "battery_percent"),
}


def test_status_json_and_the_api_say_the_same_of_a_running_agent(server: Server) -> None:
    cookie = server.enter()
    server.programs.start("run", "--no-ask", "--simulate", "zephyr,polar_h10")
    in_api = streaming(server, cookie)
    in_command = told_by_command(server)
    # Something may happen to a device between the two.
    deadline = time.monotonic() + DEADLINE_S
    while steady(in_command, in_command) != steady(in_api, in_command):
        assert time.monotonic() < deadline, (in_command, in_api)
        in_api, in_command = streaming(server, cookie), told_by_command(server)
    assert in_command["process"] and len(in_command["devices"]) == 2

    schemas = json.loads(server.request("GET", "/api/v1/openapi.json", cookie).body)["components"]
    for view, model in (("DeviceView", DeviceFacts), ("StreamView", StreamStatus)):
        told = schemas["schemas"][view]["properties"]
        for name, schema in model.model_json_schema()["properties"].items():
            assert told[name].get("type") == schema.get("type"), name


def told_by_command(server: Server) -> Entries:
    told: Entries = json.loads(server.programs.call("status", "--json"))
    AgentStatus.model_validate(told)
    return told


def streaming(server: Server, cookie: str) -> Entries:
    """Wait until both devices stream, with a clock, and return what the API says then."""
    deadline = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline:
        told = json.loads(server.request("GET", "/api/v1/status", cookie).body)
        devices = told["devices"]
        if len(devices) == 2 and all(
            each["state"] == "streaming" and each["clock"] and each["battery_percent"]
            for each in devices
        ):
            return told
        time.sleep(0.2)
    raise AssertionError("two devices never streamed")


def steady(told: Entries, model: Entries) -> Entries:
    """Return the entries that another one has, too, without those that change by themselves."""
    kept: Entries = {}
    for name, here in model.items():
        if name == "declared":
            # The API says it with each stream.
            continue
        there = told[name]
        if isinstance(here, dict):
            there = steady(there, cast("Entries", here))
        elif name == "devices":
            there = [steady(*each) for each in zip(there, here, strict=True)]
        if name not in CHANGING:
            kept[name] = there
    return kept
