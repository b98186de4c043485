"""What the API says of the agent is what ``status --json`` says, by the same models."""

from __future__ import annotations

import json
import time
from typing import Any

from biosensor_gateway.agent.status import AgentStatus, DeviceFacts, StreamStatus
from tests.page.conftest import DEADLINE_S, Server

# Counted, or measured anew each second; all else stays the same while all is well.
CHANGING = {
    *("written", "lsl_time"),
    *("offset_s", "drift_ppm", "residual_rms_s", "observations", "newest_s"),
    *("pushed", "waited", "last_stamp", "battery_percent"),
}


def test_status_json_and_the_api_say_the_same_of_a_running_agent(server: Server) -> None:
    cookie = server.enter()
    server.programs.start("run", "--no-ask", "--simulate", "zephyr,polar_h10")
    in_api = streaming(server, cookie)
    in_command: dict[str, Any] = json.loads(server.programs.call("status", "--json"))
    AgentStatus.model_validate(in_command)
    assert all(each["clock"] for each in in_command["devices"])
    assert steady(in_command) == steady(narrowed(in_api, in_command))
    assert in_api["process"] == in_command["process"]
    assert in_api["lsl_time"] <= in_command["lsl_time"] + 1

    schemas = json.loads(server.request("GET", "/api/v1/openapi.json", cookie).body)["components"]
    for view, model in (("DeviceView", DeviceFacts), ("StreamView", StreamStatus)):
        told = schemas["schemas"][view]["properties"]
        for name, schema in model.model_json_schema()["properties"].items():
            assert told[name].get("type") == schema.get("type"), name


def streaming(server: Server, cookie: str) -> dict[str, Any]:
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


def narrowed(content: Any, model: Any) -> Any:
    """Return only those entries that another one has, too."""
    if isinstance(model, dict):
        return {name: narrowed(content[name], each) for name, each in model.items()}
    if isinstance(model, list):
        return [narrowed(*pair) for pair in zip(content, model, strict=True)]
    return content


def steady(content: Any) -> Any:
    if isinstance(content, dict):
        return {name: steady(each) for name, each in content.items() if name not in CHANGING}
    return [steady(each) for each in content] if isinstance(content, list) else content
