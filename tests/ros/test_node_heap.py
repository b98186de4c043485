"""Node and agent keep to few arenas of malloc, however many threads they have."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pylsl
import pytest

from biosensor_common.process_limits import ARENAS
from tests.faults.agent import AgentProcess
from tests.rigs.arenas import count_arenas

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

# Threads that the agent begins before, for its console and its log, keep theirs.
BEFORE_AGENT = 7

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="glibc's arenas"),
]


def test_the_node_has_few_arenas(ros: Ros, start_node: Callable[..., RunningNode]) -> None:
    node = start_node()
    names = [f"arena{place}" for place in range(16)]
    outlets = [
        pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, 100.0, "float32", name))
        for name in names
    ]
    ros.attached(*(f"/biosensors/{name}/EEG" for name in names))
    for outlet in outlets:
        outlet.push_sample([1.0])
    ros.until(lambda: bool(ros.status("/biosensors/arena15/EEG")), "what the node says of it")
    print(f"{count_arenas(node.pid)} arenas")
    assert count_arenas(node.pid) == ARENAS


def test_the_agent_has_few_arenas(tmp_path: Path) -> None:
    with AgentProcess(tmp_path, "--simulate", "zephyr", environment={}) as agent:
        streams = pylsl.resolve_byprop("type", "ECG", timeout=30.0)
        print(f"{count_arenas(agent.pid)} arenas")
        assert count_arenas(agent.pid) <= ARENAS + BEFORE_AGENT
    assert streams
