"""``make demo``: every sensor, the exit code, and the list of what was not to be expected."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

EXPECTED = {
    "empatica_e4": "bvp bvp_chunk gsr st hr ibi acc quality",
    "emotiv_insight": "eeg eeg_chunk pow pow_chunk met mot dev eeg_status",
    "shimmer3_gsr": "gsr gsr_chunk ppg ppg_chunk hr bat quality",
    "polar_h10": "hr ibi ecg ecg_chunk acc bat rssi quality",
    "vernier_respiration_belt": "bpm force force_chunk bat rssi quality",
    "zephyr": "hr ecg ecg_chunk br_chunk acc ibi quality",
    "ble_heart_rate": "hr ibi bat rssi quality",
}


def _run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *command],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.fixture
def published() -> Generator[str]:
    """One topic that is published all the time."""
    process = subprocess.Popen([sys.executable, "-c", _PUBLISH], stdin=subprocess.DEVNULL)
    yield "/biosensors/test/one"
    process.kill()
    process.wait()


_PUBLISH = """
import rclpy, time
from std_msgs.msg import Float32
rclpy.init()
node = rclpy.create_node("source")
publisher = node.create_publisher(Float32, "/biosensors/test/one", 10)
while True:
    publisher.publish(Float32(data=1.5))
    time.sleep(0.05)
"""


def test_the_demo_fills_all_that_virtual_devices_of_every_kind_can_fill() -> None:
    ended = _run("biosensor_gateway.cli", "demo", "--seconds", "20")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "MISSING" not in ended.stdout
    for sensor, topics in EXPECTED.items():
        for topic in topics.split():
            assert f"/biosensors/{sensor}/{topic} " in ended.stdout
    lines = ended.stdout.splitlines()
    for topic in ("zephyr/hrv", "zephyr/st", "empatica_e4/tag", "emotiv_insight/gyro"):
        assert any(line.startswith(f"/biosensors/{topic}: not expected") for line in lines)


def test_a_topic_that_stays_empty_is_named_and_fails(published: str, tmp_path: Path) -> None:
    expected = tmp_path / "expected.json"
    absent = "/biosensors/test/absent"
    expected.write_text(json.dumps({published: "", absent: "", "/biosensors/test/late": "later"}))
    ended = _run("lsl_to_ros.live_table", "--seconds", "3", "--expect", str(expected))
    assert ended.returncode == 1, ended.stdout + ended.stderr
    assert f"{absent}: MISSING" in ended.stdout
    assert "/biosensors/test/late: not expected, later" in ended.stdout
    assert f"{published}: " not in ended.stdout
