"""A value that is not of now is not shown."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.agent.status import AgentStatus, DeviceStatus, StreamStatus
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.page.agent import Viewer
from biosensor_gateway.page.live import HOLDS_S, History
from biosensor_gateway.page.models import DeviceView, StreamView

NOW = 500.0
STRAP = DeviceIdentity("polar_h10", "A1", "P01")
SPEC = declaration("polar_h10")


class Agent:
    """An agent with one strap that has sent everything once, some time ago."""

    def __init__(self, age_s: float = 1.0) -> None:
        self._history = History()
        self._viewer = Viewer(self._history)
        for stream in SPEC.streams:
            samples = Samples(
                source_id(STRAP, stream.data_name),
                np.array([NOW - age_s]),
                np.full((1, len(stream.channels)), 72.0, np.float32),
            )
            self._history.add(samples)

    def shows(self, **changes: Any) -> DeviceView:
        streams = {
            source_id(STRAP, each.data_name): StreamStatus(
                pushed=1, lost=4, refused=0, last_stamp=NOW, withheld=0, waited=0,
                nominal_hz=each.rate if isinstance(each.rate, int | float) else 130.0, silent=False,
            ) for each in SPEC.streams
        }  # fmt: skip
        usual: dict[str, Any] = {
            "sensor": "polar_h10", "unit": "A1", "participant": "P01", "label": "",
            "state": "streaming", "paused": False, "worn": True, "connections": 1, "error": None,
            "dropped_bytes": 0, "battery_percent": 80.0, "clock": None, "streams": streams,
        }  # fmt: skip
        device = DeviceStatus(**(usual | changes))
        (shown,) = self._viewer.devices(AgentStatus(lsl_time=NOW, devices=[device]))
        return shown


def stream(device: DeviceView, data_name: str) -> StreamView:
    return device.streams[source_id(STRAP, data_name)]


def test_of_a_device_that_streams_all_is_shown() -> None:
    shown = Agent().shows()
    assert shown.is_sending
    assert (shown.lost, shown.battery_percent, shown.worn) == (4 * len(SPEC.streams), 80.0, True)
    assert all(each.is_fresh and each.values for each in shown.streams.values())


@pytest.mark.parametrize(
    "away",
    [
        {"paused": True},
        *({"state": state} for state in ("discovering", "connecting", "backoff", "stopped")),
    ],
)
def test_of_a_device_that_does_not_nothing_is(away: dict[str, Any]) -> None:
    shown = Agent().shows(**away)
    assert not shown.is_sending
    assert (shown.lost, shown.battery_percent, shown.worn) == (None, None, None)
    for each in shown.streams.values():
        assert (each.is_fresh, each.values, each.measured_hz) == (False, [], None)


def test_a_heart_rate_of_before_is_not_that_of_now_and_a_battery_holds() -> None:
    shown = Agent(age_s=HOLDS_S + 1).shows()
    for name in ("hr", "ibi", "ecg"):
        assert not stream(shown, name).is_fresh
    assert stream(shown, "bat").values == [72.0]
