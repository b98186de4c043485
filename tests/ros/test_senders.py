"""A computer from which nothing comes any more: soon said, of every stream, and once."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from tests.faults.agent import AgentProcess

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

TOPICS = tuple(f"/biosensors/zephyr/{name}" for name in ("ecg", "hr", "bat"))
COUNTERS = "/biosensors/gateway/counters"
SILENT = "nothing has come for"
HELD_S = 3.0


@pytest.fixture
def agent(tmp_path: Path) -> Iterator[AgentProcess]:
    with AgentProcess(tmp_path, "--simulate", "zephyr", environment={}) as agent:
        yield agent


def test_an_agent_that_stands_still_is_said_of_all_its_streams(
    ros: Ros, start_node: Callable[..., RunningNode], agent: AgentProcess
) -> None:
    node, host = start_node(), socket.gethostname()

    def levels() -> set[bytes]:
        statuses = [ros.status(topic) for topic in (*TOPICS, COUNTERS)]
        return {status.level if status else b"absent" for status in statuses}

    def said() -> int:
        return node.count("[WARN]", f"{host}: {SILENT}")

    ros.until(lambda: levels() == {DiagnosticStatus.OK}, "all streams")
    before = said()
    begun_s = time.monotonic()
    os.kill(agent.pid, signal.SIGSTOP)
    try:
        ros.until(lambda: levels() == {DiagnosticStatus.STALE}, "what the diagnostics say")
        said_s = time.monotonic() - begun_s
        status = ros.status(TOPICS[1])
        assert status is not None
        assert status.message.startswith(f"{host}: {SILENT}")
        ros.spin(HELD_S)
    finally:
        os.kill(agent.pid, signal.SIGCONT)
    print(f"said after {said_s:.1f} s")
    ros.until(lambda: levels() == {DiagnosticStatus.OK}, "all streams again")
    # What is written comes by another way than the diagnostics. On a busy machine nothing may
    # come for a second time; that is said, too, and so is each return.
    ros.until(
        lambda: before < said() == node.count("[INFO]", f"{host}: it is heard again"),
        "a return of each silence",
    )
