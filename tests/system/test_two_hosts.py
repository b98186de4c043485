"""Agent and node on two hosts: two network namespaces joined by a cable.

Discovery is LSL's own multicast over the cable; nothing is configured.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

TABLE_S = 12.0
# What a virtual BioHarness with a seeded body fills within seconds.
EXPECTED = ("ecg", "breathing", "acc", "hr", "br", "ibi", "bat", "rssi", "quality", "ecg_chunk")


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True)


class Hosts:
    """Two namespaces; ``agent`` is 10.77.0.1 and ``robot`` 10.77.0.2."""

    def __init__(self) -> None:
        tag = uuid.uuid4().hex[:6]
        self.names = {"agent": f"agent-{tag}", "robot": f"robot-{tag}"}
        self._ports = {"agent": f"va-{tag}", "robot": f"vr-{tag}"}

    def create(self) -> None:
        for name in self.names.values():
            _ip("netns", "add", name)
        _ip("link", "add", self._ports["agent"], "type", "veth", "peer", self._ports["robot"])
        for number, (role, name) in enumerate(self.names.items(), start=1):
            port = self._ports[role]
            _ip("link", "set", port, "netns", name)
            _ip("-n", name, "addr", "add", f"10.77.0.{number}/24", "dev", port)
            _ip("-n", name, "link", "set", "lo", "up")
            _ip("-n", name, "link", "set", port, "up")

    def remove(self) -> None:
        for name in self.names.values():
            subprocess.run(["ip", "netns", "delete", name], check=False)

    def command(self, role: str, module: str, *arguments: str) -> Sequence[str]:
        inside = ["ip", "netns", "exec", self.names[role]]
        return [*inside, sys.executable, "-m", module, *arguments]


@pytest.fixture
def hosts() -> Generator[Hosts]:
    made = Hosts()
    try:
        made.create()
        yield made
    finally:
        made.remove()


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Isolated by the namespaces; the session only tells that the settings take effect."""
    config = tmp_path / "lsl_api.cfg"
    config.write_text(f"[lab]\nSessionID = two-hosts-{uuid.uuid4().hex}\n")
    return {**os.environ, "LSLAPICFG": str(config), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}


@contextmanager
def _running(command: Sequence[str], environment: dict[str, str]) -> Generator[None]:
    process = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL)
    yield
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0, command


def test_streams_cross_the_network_unconfigured(
    hosts: Hosts, environment: dict[str, str], tmp_path: Path
) -> None:
    expected = tmp_path / "expected.json"
    expected.write_text(json.dumps({f"/biosensors/zephyr/{name}": "" for name in EXPECTED}))
    agent = hosts.command("agent", "biosensor_gateway.cli", "run", "--simulate", "zephyr")
    node = hosts.command("robot", "lsl_to_ros.node", "--ros-args", "-p", "Chunk_Length:=100")
    table = hosts.command(
        *("robot", "lsl_to_ros.live_table"),
        *("--seconds", str(TABLE_S), "--expect", str(expected)),
    )
    with ExitStack() as running:
        running.enter_context(_running(agent, environment))
        running.enter_context(_running(node, environment))
        shown = subprocess.run(
            table, env=environment, capture_output=True, text=True, timeout=120, check=False
        )
    assert shown.returncode == 0, shown.stdout + shown.stderr
    lost = [line.split()[-1] for line in shown.stdout.splitlines() if "/zephyr/ecg" in line]
    assert lost == ["0", "0"], shown.stdout
