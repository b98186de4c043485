"""The agent's events reach ROS as a topic, with nothing said of them on the ROS side."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
from std_msgs.msg import String

from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly


def test_events_are_a_topic_of_strings(
    programs: Any, listener: Any, wait_until: Callable[..., None]
) -> None:
    messages = listener.listen(String, "/biosensors/gateway/events")
    programs.node()
    with SteeredBioHarness() as device:
        programs.agent(
            f'[[device]]\nsensor = "zephyr"\nunit = "SIM3"\nport = "{device.port}"\n'
            "[events]\nheartbeat_s = 1\n"
        )

        def heard(kind: str) -> list[dict[str, Any]]:
            events = [json.loads(message.data) for message in messages]
            return [event for event in events if event["event"] == kind]

        wait_until(
            lambda: any("streaming" in beat["devices"].values() for beat in heard("heartbeat")),
            "a sign of life",
        )
        device.drop_link(2.0)
        wait_until(lambda: heard("gap_end"), "the end of the gap")
    for kind in ("disconnected", "gap_start", "gap_end"):
        (event, *_) = heard(kind)
        assert (event["sensor"], event["unit"]) == ("zephyr", "SIM3")
    assert heard("gap_end")[0]["lost"]["ecg"] > 0
