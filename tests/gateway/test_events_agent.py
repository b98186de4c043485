"""The agent announces what happens to a device: a real process, a virtual device, a real inlet."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pylsl
import pytest

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import status_file

pytestmark = pytest.mark.nightly

DEADLINE_S = 30.0
SOURCE = naming.source_id(DeviceIdentity("gateway", socket.gethostname()), "events")
DEVICE = {"sensor": "zephyr", "unit": "virtual"}
DROP_S = 3.0

OpenInlet = Callable[..., pylsl.StreamInlet]
Until = Callable[[Callable[[], bool]], None]
StartCli = Callable[..., AbstractContextManager["subprocess.Popen[bytes]"]]


def lost_by_status(folder: Path) -> dict[str, int]:
    """Return the lost samples of the only device by data name, of those that lost any."""
    streams = status_file.read_status(folder)["devices"][0]["streams"]
    lost = {source.rpartition("-")[2]: counted["lost"] for source, counted in streams.items()}
    return {name: count for name, count in lost.items() if count}


def test_a_drop_out_explains_itself(
    cli_process: StartCli, inlet: OpenInlet, until: Until, tmp_path: Path
) -> None:
    heard: list[tuple[dict[str, Any], float]] = []
    settings = ("run", "--simulate", "zephyr", "--fault", f"drop:{DROP_S:g}s@15s")
    with cli_process(tmp_path, *settings) as agent:
        reader = inlet(SOURCE, recover=True)

        def has(*kinds: str) -> bool:
            samples, stamps = reader.pull_chunk(timeout=0.0)
            texts = (row[0] for row in samples)
            heard.extend(zip(map(json.loads, texts), stamps, strict=True))
            return {*kinds} <= {event["event"] for event, _ in heard}

        until(lambda: has("heartbeat", "disconnected", "gap_start", "connected", "gap_end"))

        def announced() -> Counter[str]:
            has()
            return sum((Counter[str](each.get("lost", {})) for each, _ in heard), Counter[str]())

        # A slow stream may be told behind the others, in a gap of its own.
        until(lambda: announced() == Counter(lost_by_status(tmp_path)))
        agent.send_signal(signal.SIGTERM)
        until(lambda: has("agent_stopped"))
        assert agent.wait(DEADLINE_S) == 0
        assert "Traceback" not in (tmp_path / "stderr.txt").read_text()

    stamps = [stamp for _, stamp in heard]
    assert stamps == sorted(set(stamps))
    # Of each kind the first, as far as it was heard.
    said = {event["event"]: event for event, _ in reversed(heard)}
    assert heard[-1][0]["event"] == "agent_stopped"
    for kind in ("disconnected", "gap_start", "connected", "gap_end"):
        assert said[kind].items() >= DEVICE.items()
    assert said["disconnected"]["reason"] == "lost"
    assert 2 in {event.get("connection") for event, _ in heard}
    start, end = said["gap_start"]["lsl_time"], said["gap_end"]["lsl_time"]
    assert end - start > DROP_S - 1.1
    assert abs(said["gap_end"]["lost"]["ecg"] / 250 - (end - start)) < 1.1
    # By the heartbeats one can tell in which state a recording began.
    states = [event["devices"] for event, _ in heard if event["event"] == "heartbeat"]
    assert {"zephyr/virtual": "streaming"} in states
