"""A sensor that somebody adds takes part in everything, and no other file changes."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from std_msgs.msg import Float32

import biosensor_gateway
from biosensor_gateway.devices.registry import ENTRY_POINT_GROUP
from biosensor_gateway.settings.places import state_folder
from tests.faults.agent import fresh_status
from tests.rigs.polling import wait_until

SENSOR = "acme_band"
TOPICS = ("force", "force_chunk", "bat", "quality")
SOURCES = Path(__file__).parent / SENSOR
ROOT = Path(__file__).parents[2]
# One process for all of it: each takes seconds to import what it needs.
QUESTIONS = """
import contextlib, io, json, pathlib, sys
from biosensor_gateway import cli
from biosensor_gateway.demo.demonstration import expected_topics
from biosensor_gateway.devices.registry import sensor, sensor_names
from tests.faults.expectations import CELLS

def said(*arguments):
    sys.argv = ["biosensor-gateway", *arguments]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
        cli.main()
    return out.getvalue()

settings, device = pathlib.Path(sys.argv[1]), sys.argv[2]
said("config", "init", "--settings", str(settings))
template = settings.read_text()
settings.write_text(device)
print(json.dumps({
    "names": sensor_names(),
    "driver": sensor("acme_band").driver,
    "demo": expected_topics(30, 32),
    "cells": [kind.value for kind, name in CELLS if name == "acme_band"],
    "template": template,
    "check": said("config", "check", "--settings", str(settings)),
    "scan": json.loads(said("scan", "--simulate", "acme_band", "--seconds", "1", "--json")),
}))
"""
DEVICE = f'[[device]]\nsensor = "{SENSOR}"\nunit = "1"\nport = "/dev/ttyACM0"\n'

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform == "win32", reason="its port is a pseudo-terminal"),
]


def as_package(site: Path) -> None:
    """Another distribution, as an installer would leave it on disk."""
    shutil.copytree(SOURCES, site / SENSOR)
    folder = site / "acme_sensors-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-sensors\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text(f"[{ENTRY_POINT_GROUP}]\n{SENSOR} = {SENSOR}:SENSOR\n")


def as_folder(site: Path) -> None:
    """A checkout of ours with one folder more."""
    package = Path(biosensor_gateway.__file__).parent
    ours = site / package.name
    shutil.copytree(package, ours, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(SOURCES, ours / "devices" / SENSOR)


@pytest.fixture(params=[as_package, as_folder])
def added(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[Path], None]:
    """What every process that is started from now on finds."""
    site = tmp_path / "site"
    site.mkdir()
    request.param(site)
    monkeypatch.setenv("PYTHONPATH", str(site))
    return request.param


def output(*command: str) -> str:
    run = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


def test_it_is_known_to_demo_fault_matrix_settings_and_search(
    added: Callable[[Path], None], tmp_path: Path
) -> None:
    answers = json.loads(output("-c", QUESTIONS, str(tmp_path / "settings.toml"), DEVICE))
    assert SENSOR in answers["names"]
    inside = answers["driver"].startswith("biosensor_gateway.devices.")
    assert inside == (added is as_folder)
    topics = {topic: missing for topic, missing in answers["demo"].items() if SENSOR in topic}
    assert topics == {f"/biosensors/{SENSOR}/{name}": "" for name in TOPICS}
    kinds = ["drop", "stall", "garbage", "unreadable", "low_battery", "off_body", "drift", "asleep"]
    assert answers["cells"] == kinds
    assert f'sensor = "{SENSOR}"' in answers["template"]
    assert "1 devices, no problem found" in answers["check"]
    (section,) = (each for each in answers["scan"] if each["where"] == "Acme Band by its service")
    (found,) = section["found"]
    (table,) = tomllib.loads(found["toml"])["device"]
    assert table["sensor"] == SENSOR


def test_it_streams_to_ros_and_what_a_fault_costs_is_counted(
    added: object, programs: Any, listener: Any
) -> None:
    del added
    received = {
        name: listener.listen(Float32, f"/biosensors/{SENSOR}/{name}") for name in ("force", "bat")
    }
    programs.node()
    # They run from when the virtual band is switched on, and the agent comes later.
    fault = ("--fault", f"{SENSOR}:drop:1s@12s", "--fault", f"{SENSOR}:garbage:64@10s")
    programs.start("biosensor_gateway.cli", "run", "--simulate", SENSOR, *fault)
    wait_until(lambda: all(received.values()), "force and battery in ROS")
    assert received["bat"][0].data == 80

    folder = state_folder()

    def device() -> dict[str, Any]:
        return fresh_status(folder)["devices"][0]

    def is_counted() -> bool:
        status = device()
        lost = status["streams"][f"{SENSOR}-virtual-force"]["lost"]
        return lost >= 50 and status["dropped_bytes"] > 0

    wait_until(lambda: device()["connections"] == 2, "the second connection")
    after = len(received["force"])
    wait_until(lambda: len(received["force"]) > after + 50, "force after the fault")
    wait_until(is_counted, "the books of the fault")


# All other devices stream beside it.
@pytest.mark.alone
def test_the_demo_shows_its_topics(added: object) -> None:
    del added
    # That all others fill theirs in so short a time is not what this asks.
    command = (sys.executable, "-m", "biosensor_gateway.cli", "demo", "--seconds", "15")
    shown = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = {line.split()[0] for line in shown.stdout.splitlines() if f" {SENSOR}/" in f" {line}"}
    assert rows == {f"{SENSOR}/{name}" for name in TOPICS}, shown.stdout + shown.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="the fault matrix runs on Linux")
def test_its_row_of_the_fault_matrix_is_run(added: object, monkeypatch: pytest.MonkeyPatch) -> None:
    del added
    # It has an LSL session, a ROS domain and folders of its own.
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    tests = ("tests/faults/test_every_fault.py", "-k", f"drop-{SENSOR}")
    report = output("-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *tests)
    assert "5 passed" in report
