"""DDS: what the environment says, and real nodes that find each other or do not."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Generator
from contextlib import ExitStack

import pytest

from biosensor_common.doctor.check import AGENT, NODE, Context, Finding, Level, checks_of
from biosensor_common.doctor.probe import Probe
from biosensor_common.doctor.report import run_checks
from lsl_to_ros.doctor import GUIDE, dds
from lsl_to_ros.doctor.dds import judge_environment as judge
from tests.doctor.conftest import above_ok, only

PROBE = (sys.executable, "-m", "lsl_to_ros.doctor.dds")
LIFE_S = 60.0

Stay = Callable[[str], None]


@pytest.fixture(autouse=True)
def long_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """However busy this computer is."""
    monkeypatch.setattr(dds, "SEARCH_S", 30.0)
    monkeypatch.setattr(dds, "_LIMIT_S", 60.0)


@pytest.fixture
def stay() -> Generator[Stay]:
    """Have nodes in processes of their own until the test ends."""
    with ExitStack() as stack:

        def start(name: str) -> None:
            node = stack.enter_context(Probe("stay", LIFE_S, command=PROBE, name=name))
            assert node.answer() == {"open": True}

        yield start


def examined() -> list[Finding]:
    checks = [check._replace(limit_s=60.0) for check in checks_of(NODE) if check.name == "dds"]
    findings = list(run_checks(checks, Context(guide=GUIDE)).findings)
    assert not [each for each in findings if each.what.startswith("the check")]
    return findings


@pytest.mark.seam
def test_nodes_find_each_other_and_ours_is_missed() -> None:
    found = examined()
    assert "rmw_fastrtps_cpp" in only(found, "a node of this computer is found here in ").what
    missed = only(found, "there is no node lsl_to_ros")
    assert missed.level is Level.NOTE
    assert f"(domain {os.environ['ROS_DOMAIN_ID']}, 0 other nodes)" in missed.what


@pytest.mark.nightly
def test_our_node_is_there(stay: Stay) -> None:
    stay("lsl_to_ros")
    stay("camera")
    there = only(examined(), "/lsl_to_ros is there")
    assert (there.level, there.what.endswith(", 2 nodes in total)")) == (Level.OK, True)


@pytest.mark.nightly
def test_our_node_twice_is_an_error(stay: Stay) -> None:
    stay("lsl_to_ros")
    stay("lsl_to_ros")
    twice = only(examined(), "2 nodes have the name /lsl_to_ros")
    assert (twice.level, "namespace:=NAME" in twice.fix) == (Level.ERROR, True)


def test_one_node_in_each_namespace_is_right() -> None:
    found = dds.judge_nodes(["/a/lsl_to_ros", "/b/lsl_to_ros", "/lsl_to_ros_2"])
    assert (found.level, found.what.startswith("/a/lsl_to_ros, /b/lsl_to_ros is")) == (
        Level.OK,
        True,
    )


@pytest.mark.nightly
def test_discovery_that_is_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    monkeypatch.setattr(dds, "SEARCH_S", 3.0)
    variable, found = above_ok(examined())
    assert (variable.level, variable.what) == (
        Level.ERROR,
        "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF",
    )
    assert (found.level, "is not found here within 3 s" in found.what) == (Level.ERROR, True)
    first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])
    assert f"sudo ufw allow {first}:{first + 249}/udp" in found.fix


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("variable", "value"),
    [("ROS_STATIC_PEERS", "10.0.0.1,10.0.0.2"), ("RMW_IMPLEMENTATION", "rmw_nope")],
)
def test_a_node_that_cannot_start(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str
) -> None:
    """That ROS starts no node with such a value is so, and not only said."""
    monkeypatch.setenv(variable, value)
    found = only(examined(), "a ROS node cannot be started here")
    assert (found.level, variable in found.fix or "variables" in found.fix) == (Level.ERROR, True)


@pytest.mark.nightly
def test_a_node_ends_gently() -> None:
    """One that is only killed is listed by others for many seconds."""
    with Probe("stay", LIFE_S, command=PROBE, name="short") as node:
        assert node.answer() == {"open": True}
    assert node.process.returncode == 0


@pytest.mark.parametrize(
    ("variables", "what", "level"),
    [
        ({}, "ROS_DOMAIN_ID is not set", Level.OK),
        ({"ROS_DOMAIN_ID": "7"}, "ROS_DOMAIN_ID is 7", Level.OK),
        ({"ROS_DOMAIN_ID": "230"}, "ROS_DOMAIN_ID is 230", Level.OK),
        ({"ROS_DOMAIN_ID": "150"}, "ROS_DOMAIN_ID is 150", Level.WARNING),
        ({"ROS_DOMAIN_ID": "233"}, "not a number from 0 to 232", Level.ERROR),
        ({"ROS_DOMAIN_ID": "seven"}, "not a number from 0 to 232", Level.ERROR),
        ({}, "in the whole subnet", Level.OK),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "is SUBNET", Level.OK),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "is LOCALHOST", Level.NOTE),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, "is OFF", Level.ERROR),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "off"}, "not one of SUBNET", Level.WARNING),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "127.0.0.1"},
            "is LOCALHOST",
            Level.OK,
        ),
        ({"ROS_STATIC_PEERS": "127.0.0.1;::1"}, "127.0.0.1, ::1", Level.OK),
        ({"ROS_STATIC_PEERS": "127.0.0.1,127.0.0.2"}, "which has no address", Level.ERROR),
        ({"ROS_LOCALHOST_ONLY": "1"}, "ROS_LOCALHOST_ONLY is 1", Level.WARNING),
        ({"ROS_LOCALHOST_ONLY": "0"}, "ROS_LOCALHOST_ONLY is set", Level.NOTE),
        ({"ROS_DISCOVERY_SERVER": "10.0.0.1:11811"}, "ROS_DISCOVERY_SERVER is", Level.NOTE),
        (
            {"ROS_DISCOVERY_SERVER": "10.0.0.1:11811", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
            "RMW_IMPLEMENTATION is rmw_cyclonedds_cpp",
            Level.WARNING,
        ),
    ],
)
def test_what_the_environment_says(variables: dict[str, str], what: str, level: Level) -> None:
    assert only(list(judge(variables)), what).level is level


def test_variables_that_are_ignored_are_not_judged() -> None:
    variables = {"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "x;y"}
    assert not [each for each in judge(variables) if "has no address" in each.what]


@pytest.mark.nightly
def test_a_computer_without_ros_is_not_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert not examined()


@pytest.mark.nightly
def test_the_agent_s_doctor_has_it_where_ros_is() -> None:
    assert "dds" in [check.name for check in checks_of(AGENT)]
    for missing in ("rclpy", "lsl_to_ros"):
        code = (
            f"import sys; sys.modules[{missing!r}] = None\n"
            "from biosensor_common.doctor.check import AGENT, checks_of\n"
            "print([check.name for check in checks_of(AGENT) if check.name == 'dds'])"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == "[]"


@pytest.mark.nightly
def test_the_node_s_doctor_is_a_program() -> None:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "lsl_to_ros.doctor", *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    done = run("--json", "--only", "host_name", "--only", "lsl_config")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["checks"] == ["lsl_config", "host_name"]
    assert run("--only", "weather").returncode == 2


def test_the_node_s_remedies_are_those_of_its_computer() -> None:
    """The agent's commands are not there."""
    remedies = [GUIDE.ask_itself, GUIDE.ask_others.format(peer="1"), GUIDE.correct_file, GUIDE.edit]
    remedies += [GUIDE.install, GUIDE.install_pylsl, *GUIDE.libraries.values()]
    remedies.append(GUIDE.alone.format(check="dds"))
    assert not [each for each in remedies if "biosensor-gateway" in each]
    assert [each.name for each in checks_of(NODE) if "biosensor_gateway" in each.module] == []
