"""Devices have room for their streams in the order of the settings, as far as there is some."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.device_set import Device, DeviceSet
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.streaming.sink import DeviceSink

ENDS_WITHIN_S = 60.0


def test_devices_get_room_in_the_order_of_the_settings() -> None:
    room = Room(20)
    said = room.share_out({"polar_h10/a": 7, "zephyr/b": 14, "muse/c": 8})
    assert said.startswith("20 streams fit, and 29 are wanted; left out are zephyr/b (14): this")
    assert [room.has(each) for each in ("polar_h10/a", "zephyr/b", "muse/c")] == [True, False, True]
    with pytest.raises(
        TransportError, match=r"its 14 streams are left out.* run in this"
    ) as caught:
        room.take("zephyr/b", 14)
    assert caught.value.reason is TransportReason.EXHAUSTED


def test_room_that_is_given_back_is_another_devices() -> None:
    room = Room(10)
    room.share_out({"polar_h10/a": 7, "muse/c": 8})
    room.give_back("polar_h10/a")
    room.take("muse/c", 8)
    # A device that has room already needs no more.
    room.take("muse/c", 8)
    with pytest.raises(TransportError):
        room.take("polar_h10/a", 7)


def test_nothing_is_said_where_all_fit() -> None:
    assert Room(15).share_out({"polar_h10/a": 7, "muse/c": 8}) == ""
    assert Room(None).share_out({"polar_h10/a": 10_000}) == ""


def test_an_agent_without_room_for_any_device_ends() -> None:
    device = DeviceSettings(sensor="gateway", unit="a")
    identity = DeviceIdentity("gateway", "a")
    sink = DeviceSink(identity, declaration("gateway"))
    made = Device(Supervisor(lambda: pytest.fail("it is connected"), sink), sink)
    devices = dict(zip([device], [made], strict=True))
    with pytest.raises(
        TransportError, match=r"^0 streams fit, .* left out are gateway/a"
    ) as caught:
        DeviceSet(devices, Room(0)).make_room()
    assert caught.value.reason is TransportReason.EXHAUSTED
    fleet = DeviceSet(devices, Room(made.streams))
    fleet.make_room()
    assert fleet.with_room == [made]


AGENT = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (100, int(sys.argv.pop(1))))
from biosensor_gateway.cli import main
main()
"""


def start(folder: Path, limit: int, devices: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", AGENT, str(limit), "run", "--simulate", devices],
        env={**os.environ, "BIOSENSOR_GATEWAY_STATE": str(folder)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def states(folder: Path) -> dict[str, tuple[str, str]]:
    try:
        devices = json.loads((folder / "status.json").read_text())["devices"]
    except (OSError, ValueError):
        return {}
    return {each["sensor"]: (each["state"], each["error"] or "") for each in devices}


@pytest.mark.seam
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
def test_an_agent_streams_what_fits_and_says_what_is_left_out(tmp_path: Path) -> None:
    agent = start(tmp_path, 450, "polar_h10,zephyr")
    try:
        until_s = time.monotonic() + ENDS_WITHIN_S
        while states(tmp_path).get("polar_h10", ("", ""))[0] != "streaming":
            assert agent.poll() is None
            assert time.monotonic() < until_s, states(tmp_path)
            time.sleep(0.1)
        state, error = states(tmp_path)["zephyr"]
    finally:
        agent.terminate()
        _, said = agent.communicate(timeout=ENDS_WITHIN_S)
    assert state == "backoff"
    assert error.startswith("its 13 streams are left out: this computer lets a program open 450")
    assert "left out are zephyr/virtual (13)" in said
    assert agent.returncode == 0
