"""An agent is killed while a Bluetooth device is connected, and started again.

Nobody has told the system to let go of the device: BlueZ keeps the connection when the
program that asked for it is gone, and a strap that is connected does not advertise.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pylsl
import pytest

from tests.faults.agent import AgentProcess
from tests.faults.expectations import source
from tests.faults.recorder import Recorder
from tests.faults.scenarios.figures import Record
from tests.faults.scenarios.stage import (
    channels_of,
    doomed,
    kill,
    lab_of,
    wait_until,
    write_settings,
)

STRAP = "polar_h10"
ECG = source(STRAP, "ecg")
# An agent and its first scan take five seconds on a computer that is busy.
DEADLINE_S = 20.0

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(
        sys.platform != "linux" or not shutil.which("dbus-daemon"),
        reason="a Linux with dbus-daemon is needed",
    ),
]


def test_a_device_that_was_left_connected_streams_again(tmp_path: Path, figures: Record) -> None:
    with lab_of([STRAP], tmp_path) as lab:
        settings = write_settings(tmp_path, lab, {STRAP: STRAP})
        with doomed(tmp_path, *settings, environment=lab.environment) as agent:
            with Recorder(channels_of([STRAP])) as before:
                wait_until(lambda: before.newest(ECG), "a strap that streams")
            kill(agent)
        killed_s = pylsl.local_clock()
        with (
            AgentProcess(tmp_path, *settings, environment=lab.environment),
            Recorder(channels_of([STRAP])) as recorder,
        ):
            wait_until(lambda: recorder.newest(ECG) > killed_s, "the strap", DEADLINE_S)
            after_s = pylsl.local_clock() - killed_s
    figures("agent killed, Bluetooth", "streams again after", "<= 5 s", f"{after_s:.1f} s")
