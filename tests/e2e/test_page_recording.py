"""What the page's button records, and what ROS has, are the same samples, markers included."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import pyxdf
from numpy.typing import NDArray
from playwright.sync_api import Page, expect
from std_msgs.msg import Float32, Float32MultiArray, String

from tests.rigs.chromium import chromium
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

RECORD_S = 6.0
DEADLINE_MS = 60_000
SETTINGS = """
[markers]
buttons = ["baseline"]

[[device]]
sensor = "zephyr"
unit = "A"
port = "{port}"
"""
TYPES = {"ecg": Float32, "breathing": Float32, "acc": Float32MultiArray}
_ADDRESS = re.compile(r"http://\S+")
_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def _rows(messages: list[Any]) -> NDArray[np.float32]:
    return np.array([np.atleast_1d(each.data) for each in messages], np.float32)


def _is_part(part: NDArray[np.float32], whole: NDArray[np.float32]) -> bool:
    """Whether rows are somewhere in others, one after the other without a gap."""
    return any(
        (whole[first : first + len(part)] == part).all()
        for first in range(len(whole) - len(part) + 1)
    )


def _use(page: Page, address: str, folder: Path) -> None:
    page.goto(address)
    session = page.get_by_role("region", name="Recording")
    session.get_by_label("Participant").fill("p01")
    session.get_by_label("Folder").fill(str(folder))
    session.get_by_role("button", name="Record").click()
    expect(session.get_by_text("recording, all streams grow")).to_be_visible(timeout=DEADLINE_MS)
    markers = page.get_by_role("region", name="Markers")
    markers.get_by_role("button", name="baseline").click()
    markers.get_by_label("Note").fill("the robot stopped")
    markers.get_by_role("button", name="Send note").click()
    expect(markers.locator("li", has_text="the robot stopped")).to_be_visible()
    time.sleep(RECORD_S)
    session.get_by_role("button", name="Stop recording").click()
    expect(session.locator(".verdict")).to_be_visible(timeout=DEADLINE_MS)


def test_the_file_and_the_topics_hold_the_same(
    programs: Any, listener: Any, wait_until: Callable[..., None], tmp_path: Path
) -> None:
    heard = {
        name: listener.listen(kind, f"/biosensors/zephyr/{name}") for name, kind in TYPES.items()
    }
    told = listener.listen(String, "/biosensors/gateway/markers")
    programs.node()
    with SteeredBioHarness() as device, chromium() as browser:
        programs.agent(SETTINGS.format(port=device.port))
        wait_until(lambda: all(heard.values()), "topics of the device")
        server = programs.start(
            "biosensor_gateway.cli",
            "page",
            "--no-open",
            "--settings",
            str(tmp_path / "settings.toml"),
        )
        wait_until(lambda: _ADDRESS.search(programs.log(server)), "the page's address")
        found = _ADDRESS.search(programs.log(server))
        assert found is not None
        _use(browser.new_page(), found[0], tmp_path / "recordings")

    (file,) = (tmp_path / "recordings").rglob("*.xdf")
    streams, _ = _load_xdf(str(file), synchronize_clocks=False, dejitter_timestamps=False)
    recorded = {
        each["info"]["desc"][0]["biosensor"][0]["data_name"][0]: each["time_series"]
        for each in streams
    }
    for name, messages in heard.items():
        values = np.asarray(recorded[name], np.float32)
        assert len(values) > 10 * RECORD_S, name
        assert _is_part(values, _rows(messages)), name
    markers = [text for (text,) in recorded["markers"]]
    said = [json.loads(text)["marker"] for text in markers]
    assert [each for each in said if each != "ready"] == ["baseline", "note"]
    in_ros = [message.data for message in told]
    assert in_ros[-len(markers) :] == markers
