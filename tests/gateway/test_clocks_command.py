"""``clocks``, and how the state of a device's clock travels with the counters."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pylsl
import pytest

from biosensor_common.device_clock import ClockState, DeviceClock
from biosensor_common.ros.messages import read_counters
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import snapshot
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.recording.xdf.counters import Reading, parse_readings
from biosensor_gateway.streaming.counters import Counters, counters_text
from biosensor_gateway.streaming.sink import DeviceSink

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

Run = Callable[..., "Outcome"]
StartCli = Callable[..., AbstractContextManager["subprocess.Popen[bytes]"]]

DEADLINE_S = 30.0
CLOCK = {
    "offset_s": -1795230819.108031,
    "drift_ppm": -38.04,
    "residual_rms_s": 0.0033,
    "reanchors": 2,
    "observations": 4711,
    "newest_s": 998.5,
}
DEVICE: dict[str, Any] = {
    "sensor": "zephyr",
    "unit": "BHT012345",
    "participant": "p01",
    "label": "[left]",
    "state": "streaming",
    "error": None,
    "clock": CLOCK,
    "streams": {},
}


def write_status(state: Path, *devices: dict[str, Any], **more: object) -> None:
    written = {"written": time.time(), "process": 1, "lsl_time": 1000.0, "devices": list(devices)}
    status_file.write_status(state, written | more)


def test_without_an_agent_it_fails(run: Run) -> None:
    for arguments in ((), ("--json",), ("--watch",), ("--watch", "--json")):
        outcome = run("clocks", *arguments)
        assert (outcome.code, outcome.out.strip()) == (1, "")
        assert "no agent is running" in outcome.err


def test_a_row_has_all_figures_of_a_clock_uncut(run: Run, state: Path) -> None:
    strap = {**DEVICE, "sensor": "ble_heart_rate", "label": "", "clock": None}
    absent = {**strap, "participant": "", "state": "discovering"}
    write_status(state, DEVICE, strap, absent)
    outcome = run("clocks")
    assert (outcome.code, outcome.err) == (0, "")
    assert "-1795230819.108031" in outcome.out
    rows = [line.split() for line in outcome.out.splitlines()]
    assert rows[0][:5] == ["device", "offset", "s", "drift", "ppm"]
    figures = ["-1795230819.108031", "-38.0", "3.300", "2", "1.50"]
    assert next(row for row in rows if row[0] == "p01")[-5:] == figures
    text = " ".join(outcome.out.split())
    assert "[left]" in text
    assert "none" in text
    assert "discovering" in text


def test_for_scripts_there_is_one_entry_a_device(run: Run, state: Path) -> None:
    write_status(state, DEVICE, {**DEVICE, "clock": None})
    outcome = run("clocks", "--json")
    assert (outcome.code, outcome.err) == (0, "")
    first, second = json.loads(outcome.out)["clocks"]
    assert first["clock"] == {**CLOCK, "age_s": 1.5}
    assert (first["sensor"], first["participant"], first["label"]) == ("zephyr", "p01", "[left]")
    assert second["clock"] is None


def test_a_report_of_an_older_agent_has_no_age(run: Run, state: Path) -> None:
    older = {name: value for name, value in CLOCK.items() if name != "newest_s"}
    write_status(state, {**DEVICE, "clock": older})
    (entry,) = json.loads(run("clocks", "--json").out)["clocks"]
    assert entry["clock"] == {**older, "age_s": None}
    assert run("clocks").code == 0


@pytest.mark.nightly
def test_watching_reports_every_second_until_ctrl_c(cli_process: StartCli, tmp_path: Path) -> None:
    with cli_process(tmp_path, "run", "--simulate", "zephyr"):
        waiting = [sys.executable, "-m", "biosensor_gateway.cli", "wait-ready"]
        environment = os.environ | {"BIOSENSOR_GATEWAY_STATE": str(tmp_path)}
        subprocess.run(waiting, env=environment, check=True, capture_output=True)
        watching = subprocess.Popen(
            [*waiting[:-1], "clocks", "--watch", "--json"],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert watching.stdout is not None
        reports = [json.loads(watching.stdout.readline()) for _ in range(4)]
        watching.send_signal(signal.SIGINT)
        _, err = watching.communicate(timeout=DEADLINE_S)
    assert (watching.returncode, err) == (0, "")
    clocks = [report["clocks"][0]["clock"] for report in reports]
    assert clocks[-1]["observations"] > clocks[0]["observations"]
    # The virtual device's clock runs as this computer's; its packets hold a second at most.
    assert all(abs(clock["drift_ppm"]) < 250 for clock in clocks)
    assert all(-1.0 < clock["age_s"] < 5.0 for clock in clocks)
    assert clocks[-1]["reanchors"] == 0


def test_the_age_is_that_of_the_newest_sample() -> None:
    clock = DeviceClock()
    assert math.isnan(clock.state.newest_s)
    clock.observe(10.0, 110.0)
    clock.observe(11.0, 111.0)
    assert clock.state.newest_s == pytest.approx(clock.to_lsl(11.0))
    # A late packet is no newer one.
    clock.observe(10.5, 111.2)
    assert clock.state.newest_s == pytest.approx(111.0, abs=0.01)


def test_the_status_has_the_time_to_which_the_ages_belong(unit: str) -> None:
    sink = DeviceSink(DeviceIdentity("zephyr", unit), declaration("zephyr"))
    sink.open(DeviceInfo(), {})
    now = pylsl.local_clock()
    sink.observe(5.0, now)
    taken = snapshot([]).lsl_time
    assert taken is not None
    assert taken - sink.clock_state.newest_s == pytest.approx(0.0, abs=DEADLINE_S)
    assert sink.clock_state.newest_s == pytest.approx(now)
    rates = {source.rpartition("-")[2]: rate for source, rate in sink.nominal_rates.items()}
    assert (rates["ecg"], rates["acc"], rates["hr"]) == (250, 50, 0)
    sink.close()


STATE = ClockState(-1795230819.1080315, 3.18160, 0.000271, 1, 9, 5.0)


def test_the_counters_carry_the_clock_once_a_device() -> None:
    counters = {"a-1-x": Counters(5, 4, 3, 2.5), "a-1-y": Counters(), "b-1-z": Counters()}
    unknown = ClockState(math.nan, math.nan, math.nan, 0, 0)
    text = counters_text(counters, {"a-1-x": STATE, "b-1-z": unknown})
    entries = json.loads(text)
    assert entries["a-1-x"] == {
        "pushed": 5,
        "lost": 4,
        "last_stamp": 2.5,
        "clock": {
            "offset_s": -1795230819.108032,
            "drift_ppm": 3.18,
            "residual_rms_s": 0.000271,
            "reanchors": 1,
        },
    }
    assert entries["a-1-y"].keys() == entries["b-1-z"].keys() == {"pushed", "lost", "last_stamp"}


def test_readers_of_the_counters_are_not_disturbed_by_it() -> None:
    text = counters_text({"a-1-x": Counters(5, 4, 3, 2.5)}, {"a-1-x": STATE})
    (entry,) = read_counters(text).values()
    assert (entry["pushed"], entry["lost"], entry["last_stamp"]) == (5, 4, 2.5)
    readings, unreadable = parse_readings([text])
    assert (unreadable, list(readings)) == (0, ["a-1-x"])
    assert readings["a-1-x"] == [Reading(5, 4, 2.5)]
