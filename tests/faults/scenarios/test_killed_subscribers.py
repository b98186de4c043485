"""Programs that subscribe to the node crash, one after the other; those that follow hear it.

With Fast DDS's shared memory about one in two hundred kept those from hearing anything that
were started after it, for as long as the node ran.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from statistics import median

import numpy as np
import pylsl
import pytest

from tests.faults.scenarios.figures import Record, is_long
from tests.faults.scenarios.killed_subscribers import AT_ONCE, PATIENCE_S
from tests.faults.scenarios.one_computer import ThisMachine
from tests.rigs.hosts.programs import Program

FAULT = "subscribers killed while they take messages"
ROUNDS = 100 if is_long() else 10
RATE_HZ = 500.0
PUSH_S = 0.02

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(ROUNDS * 10 + 60)]


def test_those_that_come_after_them_hear_the_node(tmp_path: Path, figures: Record) -> None:
    info = pylsl.StreamInfo("crashes", "EEG", 2, RATE_HZ, "float32", "crashes id")
    outlet = pylsl.StreamOutlet(info)
    module = "tests.faults.scenarios.killed_subscribers"
    command = [sys.executable, "-m", module, "/biosensors/crashes/EEG", str(ROUNDS)]
    samples = np.zeros((int(RATE_HZ * PUSH_S), 2), np.float32)
    with (
        Program(ThisMachine(), os.environ, tmp_path, "lsl_to_ros.node") as node,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as subscribers,
    ):
        while subscribers.poll() is None:
            outlet.push_chunk(samples)
            try:
                subscribers.wait(PUSH_S)
            except subprocess.TimeoutExpired:
                continue
        assert subscribers.stdout is not None
        found = json.loads(subscribers.stdout.read())
    assert len(found) == ROUNDS * AT_ONCE, node.log
    heard = [seconds for seconds in found if seconds is not None]
    figures(FAULT, "subscribers that heard nothing", "0", f"{len(found) - len(heard)}")
    text = f"{median(heard):.1f} s, {max(heard):.1f} s"
    figures(FAULT, "first message after the start: median, worst", "reported", text)
    assert len(heard) == len(found), f"{found}: nothing came within {PATIENCE_S} s\n{node.log}"
