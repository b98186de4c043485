"""``make demo``: every sensor, the exit code, and the list of what was not to be expected."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from biosensor_gateway.demo.demonstration import CHUNK_LENGTH, demo_devices, expected_topics

pytestmark = pytest.mark.nightly

# A chunk of 4 Hz takes eight of them, and finding and connecting all devices twenty on a busy
# computer.
SECONDS = 40
TESTS = Path(__file__).parents[1]


def _declared_by_hand(sensor: str) -> set[str]:
    """Topics of a sensor, as its tests say them once more."""
    rows = json.loads((TESTS / sensor / "streams.json").read_text())
    called = {row[key] for row in rows for key in ("data_name", "chunk_topic") if row[key]}
    return {f"/biosensors/{sensor}/{name}" for name in called}


def _run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *command],
        capture_output=True,
        text=True,
        timeout=150,
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


# Fourteen devices, the node and the table keep most of two cores busy.
@pytest.mark.alone
def test_the_demo_fills_all_that_virtual_devices_of_every_kind_can_fill() -> None:
    expected = expected_topics(SECONDS, CHUNK_LENGTH)
    assert {topic for each in demo_devices() for topic in _declared_by_hand(each)} == set(expected)
    ended = _run("biosensor_gateway.cli", "demo", "--seconds", str(SECONDS))
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "MISSING" not in ended.stdout
    lines = ended.stdout.splitlines()
    for topic, reason in expected.items():
        row = f"{topic.removeprefix('/biosensors/')} "
        begin = f"{topic}: not expected, {reason}" if reason else row
        assert any(line.startswith(begin) for line in lines), topic


@pytest.mark.parametrize("command", ["demo", "try"])
def test_sigterm_ends_all_its_programs_and_leaves_none(command: str, tmp_path: Path) -> None:
    options = [] if command == "demo" else ["--no-open", "--folder", str(tmp_path / "try")]
    process = subprocess.Popen(
        [sys.executable, "-m", "biosensor_gateway.cli", command, *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    here, deadline = psutil.Process(process.pid), time.monotonic() + 60.0
    try:
        while not {"run", "lsl_to_ros.node"} <= _arguments(here):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.1)
        started = here.children(recursive=True)
        process.send_signal(signal.SIGTERM)
        process.wait(20.0)
        _, alive = psutil.wait_procs(started, timeout=1.0)
        assert [each.cmdline() for each in alive] == []
    finally:
        for each in [*here.children(recursive=True), here] if here.is_running() else []:
            each.kill()
        process.wait()


def test_an_interrupt_before_the_table_is_shown_is_one_line() -> None:
    # As a terminal does, to all programs that share it.
    process = subprocess.Popen(
        [sys.executable, "-m", "biosensor_gateway.cli", "demo"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    here, deadline = psutil.Process(process.pid), time.monotonic() + 60.0
    try:
        while "lsl_to_ros.live_table" not in _arguments(here):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=60.0)
        assert (said, process.returncode) == ("Ended before the table was shown.\n", 130)
    finally:
        for each in [*here.children(recursive=True), here] if here.is_running() else []:
            each.kill()
        process.wait()


def _arguments(of: psutil.Process) -> set[str]:
    found = set[str]()
    for each in of.children(recursive=True):
        with suppress(psutil.Error):
            found |= {*each.cmdline()}
    return found


def test_a_topic_that_stays_empty_is_named_and_fails(published: str, tmp_path: Path) -> None:
    expected = tmp_path / "expected.json"
    absent = "/biosensors/test/absent"
    expected.write_text(json.dumps({published: "", absent: "", "/biosensors/test/late": "later"}))
    ended = _run("lsl_to_ros.live_table", "--seconds", "3", "--expect", str(expected))
    # On a busy computer nothing tells what is late from what is broken.
    word = {1: "MISSING", 3: "not yet"}.get(ended.returncode)
    assert f"{absent}: {word}" in ended.stdout, ended.stdout + ended.stderr
    assert "/biosensors/test/late: not expected, later" in ended.stdout
    assert f"{published}: " not in ended.stdout


def test_a_state_that_was_published_before_is_shown(tmp_path: Path) -> None:
    state = "/biosensors/test/state"
    expected = tmp_path / "expected.json"
    expected.write_text(json.dumps({state: ""}))
    program = _PUBLISH_ONCE.format(topic=state)
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as source:
        try:
            assert source.stdout is not None
            assert source.stdout.readline() == b"published\n"
            ended = _run("lsl_to_ros.live_table", "--seconds", "3", "--expect", str(expected))
        finally:
            source.kill()
    assert ended.returncode == 0, ended.stdout + ended.stderr
    (row,) = (line for line in ended.stdout.splitlines() if line.startswith(state))
    assert "87" in row.split()


_PUBLISH_ONCE = """
import rclpy, time
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float32
rclpy.init()
node = rclpy.create_node("source")
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(Float32, "{topic}", qos).publish(Float32(data=87.0))
print("published", flush=True)
time.sleep(600)
"""
