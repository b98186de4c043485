"""Fast DDS is configured unless the user has done it, and uses no shared memory."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import TYPE_CHECKING, cast
from xml.etree import ElementTree

import pytest
from rclpy.logging import RcutilsLogger

from lsl_to_ros import limited_log, ros_environment
from lsl_to_ros.limited_log import BURST, BURST_S, SAME_AGAIN_S, LimitedLog
from lsl_to_ros.ros_environment import ensure_log_folder, usual_folder
from tests.rigs.virtual_time import SetClock

if TYPE_CHECKING:
    from tests.ros.conftest import Ros

FAST_DDS = "rmw_fastrtps_cpp"
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
TIMEOUT_S = 120.0
ROOT = Path(__file__).parents[2]

# The one that this ROS has: make venv-kilted brings the newer one.
HERE = ros_environment.fast_dds_generation()

# A participant like the node's; it says what shared memory it has.
PARTICIPANT = """
import json, os, pathlib, rclpy
from lsl_to_ros import ros_environment
if os.environ.get("CONFIGURE"):
    rmw = rclpy.get_rmw_implementation_identifier()
    generation = ros_environment.fast_dds_generation()
    assert ros_environment.configure_fast_dds(os.environ, pathlib.Path("/"), rmw, generation)
rclpy.init(args=[])
node = rclpy.create_node("participant")
maps = pathlib.Path("/proc/self/maps").read_text().splitlines()
print(json.dumps(sorted({line.split()[-1] for line in maps if "/dev/shm/fast" in line})))
"""


@pytest.fixture(params=[2, 3], ids=["Fast DDS 2", "Fast DDS 3"])
def fast_dds(request: pytest.FixtureRequest) -> int:
    return request.param


def configured(tmp_path: Path, fast_dds: int, **variables: str) -> dict[str, str]:
    """Return the environment as it is set for Fast DDS."""
    environment = dict(variables)
    assert ros_environment.configure_fast_dds(environment, tmp_path, FAST_DDS, fast_dds)
    return environment


def profiles(environment: dict[str, str]) -> ElementTree.Element:
    """Take the one file that is named out of the environment, and read it."""
    (name,) = environment.keys() & set(ros_environment.PROFILES)
    return ElementTree.parse(environment.pop(name)).getroot()


# A program that lives on, and announces itself at its start and then for an hour not any more.
QUIET_PEER = """
import rclpy, sys
rclpy.init(args=[])
node = rclpy.create_node("quiet_peer")
print("up", flush=True)
sys.stdin.read()
"""
QUIET = """
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
  <participant profile_name="quiet" is_default_profile="true"><rtps><builtin><discovery_config>
    <initialAnnouncements><count>0</count></initialAnnouncements>
    <leaseDuration><sec>7200</sec></leaseDuration>
    <leaseAnnouncement><sec>3600</sec></leaseAnnouncement>
  </discovery_config></builtin></rtps></participant>
</profiles></dds>
"""

# Participants like the node's, one after another; it says which heard the one that lives on.
PARTICIPANTS = """
import json, os, pathlib, rclpy, time
from lsl_to_ros import ros_environment
rmw = rclpy.get_rmw_implementation_identifier()
generation = ros_environment.fast_dds_generation()
assert ros_environment.configure_fast_dds(os.environ, pathlib.Path("/"), rmw, generation)
heard = []
for number in range(12):
    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    node = rclpy.create_node(f"participant{number}", context=context)
    end = time.monotonic() + 3
    while "quiet_peer" not in node.get_node_names() and time.monotonic() < end:
        time.sleep(0.02)
    heard.append("quiet_peer" in node.get_node_names())
    node.destroy_node()
    rclpy.shutdown(context=context)
print(json.dumps(heard))
"""


@pytest.mark.parametrize(("release", "expected"), [("7.1.6", 2), ("9.1.2", 3), ("10.0.0", 3)])
def test_each_ros_has_its_fast_dds(
    release: str, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_environment, "version", {"rclpy": release}.__getitem__)
    assert ros_environment.fast_dds_generation() == expected


def test_a_ros_that_does_not_say_its_version_is_a_newer_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nothing(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(ros_environment, "version", nothing)
    assert ros_environment.fast_dds_generation() == 3


def test_no_fast_dds_is_given_the_file_of_the_other(tmp_path: Path, fast_dds: int) -> None:
    # ROS beside Fast DDS 3 reads the variable of Fast DDS 2, too.
    named = configured(tmp_path, fast_dds).keys() & set(ros_environment.PROFILES)
    assert named == {ros_environment.PROFILES[fast_dds - 2]}


@pytest.mark.parametrize("range_", ["", "LOCALHOST"])
def test_both_are_told_the_same_by_their_own_names(tmp_path: Path, range_: str) -> None:
    variables = {"ROS_AUTOMATIC_DISCOVERY_RANGE": range_}
    two, three = (profiles(configured(tmp_path, each, **variables)) for each in (2, 3))
    for root, limit in ((two, "throughputController"), (three, "flow_controller_descriptor_list")):
        (rtps,) = root.iterfind(".//{*}rtps")
        (found,) = rtps.iterfind(f"{{*}}{limit}")
        # 0 bytes are no limit.
        assert {each.text for each in found.iter() if "ytes" in each.tag} == {"0"}
        rtps.remove(found)
    texts = [ElementTree.tostring(root, encoding="unicode") for root in (two, three)]
    texts[0] = texts[0].replace("heartbeatPeriod", "heartbeat_period")
    assert ElementTree.canonicalize(texts[0], strip_text=True) == ElementTree.canonicalize(
        texts[1], strip_text=True
    )


@pytest.mark.parametrize("range_", ["", "SUBNET", "LOCALHOST"])
def test_what_is_lost_is_sent_again_after_50_ms(tmp_path: Path, range_: str, fast_dds: int) -> None:
    root = profiles(configured(tmp_path, fast_dds, ROS_AUTOMATIC_DISCOVERY_RANGE=range_))
    name = {2: "heartbeatPeriod", 3: "heartbeat_period"}[fast_dds]
    (period,) = root.findall(f".//{{*}}data_writer[@is_default_profile='true']//{{*}}{name}")
    assert (period.findtext("{*}sec"), period.findtext("{*}nanosec")) == ("0", "50000000")


@pytest.mark.parametrize("range_", ["", "SUBNET", "LOCALHOST"])
def test_the_node_says_every_half_second_that_it_is_there(
    tmp_path: Path, range_: str, fast_dds: int
) -> None:
    root = profiles(configured(tmp_path, fast_dds, ROS_AUTOMATIC_DISCOVERY_RANGE=range_))
    (period,) = root.findall(".//{*}participant[@is_default_profile='true']//{*}leaseAnnouncement")
    assert (period.findtext("{*}sec"), period.findtext("{*}nanosec")) == ("0", "500000000")


def test_everything_goes_over_udp(tmp_path: Path, fast_dds: int) -> None:
    environment = configured(tmp_path, fast_dds, ROS_DOMAIN_ID="7")
    assert profiles(environment).find(".//{*}userTransports") is None
    assert environment == {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "ROS_DOMAIN_ID": "7"}


def test_on_this_machine_alone_it_does_too_and_peers_stay(tmp_path: Path, fast_dds: int) -> None:
    environment = configured(tmp_path, fast_dds, **LOCAL, ROS_STATIC_PEERS="192.0.2.1")
    root = profiles(environment)
    assert [one.text for one in root.iterfind(".//{*}transport_descriptor/{*}type")] == ["UDPv4"]
    assert root.findtext(".//{*}useBuiltinTransports") == "false"
    assert root.findtext(".//{*}initialPeersList//{*}address") == "127.0.0.1"
    assert environment["ROS_STATIC_PEERS"] == "192.0.2.1"
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"


def test_the_old_variable_for_this_machine_comes_first_and_knows_no_peers(tmp_path: Path) -> None:
    variables = {"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "192.0.2.1"}
    new = configured(tmp_path, HERE, **variables, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
    assert new == configured(tmp_path, HERE, **LOCAL)


def test_transports_that_the_user_chose_stay(tmp_path: Path) -> None:
    variables = {**LOCAL, "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
    environment = configured(tmp_path, HERE, **variables)
    assert profiles(environment).find(".//{*}userTransports") is None
    assert environment == variables


@pytest.mark.parametrize("name", ros_environment.PROFILES)
def test_a_file_that_the_user_names_stays(tmp_path: Path, name: str, fast_dds: int) -> None:
    environment = {name: "mine.xml", **LOCAL}
    assert not ros_environment.configure_fast_dds(environment, tmp_path, FAST_DDS, fast_dds)
    assert environment == {name: "mine.xml", **LOCAL}


@pytest.mark.parametrize("name", ros_environment.IN_FOLDER)
def test_a_file_in_the_working_folder_stays(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    environment = dict(LOCAL)
    assert not ros_environment.configure_fast_dds(environment, tmp_path, FAST_DDS, HERE)
    assert environment == LOCAL


def test_another_middleware_is_left_alone(tmp_path: Path) -> None:
    environment = dict(LOCAL)
    assert not ros_environment.configure_fast_dds(environment, tmp_path, "rmw_cyclonedds_cpp", HERE)
    assert environment == LOCAL


# In a network of its own, where a program may call into all that it has.
ALONE = ("unshare", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "sh")


def shared_memory(*before: str, **variables: str) -> list[str]:
    """Return the files of shared memory that a participant has."""
    environment = {**os.environ, **variables}
    command = [*before, sys.executable, "-c", PARTICIPANT]
    done = subprocess.run(
        command,
        env=environment,
        check=True,
        timeout=TIMEOUT_S,
        capture_output=True,
        text=True,
    )
    if "CONFIGURE" in variables:
        # A file that Fast DDS does not take would be known by its lines there alone.
        assert done.stderr == ""
    return json.loads(done.stdout)


@pytest.mark.nightly
@pytest.mark.parametrize("variable", ["ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"])
def test_fast_dds_does_as_it_is_told(variable: str) -> None:
    local = {variable: LOCAL.get(variable, "1")}
    assert not shared_memory(CONFIGURE="1", **local)
    # Of its own accord it has shared memory, by which this test would notice if it still had.
    assert shared_memory(**local)


@pytest.mark.system
@pytest.mark.parametrize("range_", ["SUBNET", "SYSTEM_DEFAULT"])
def test_with_multicast_it_does_as_it_is_told_too(range_: str) -> None:
    assert not shared_memory(*ALONE, CONFIGURE="1", ROS_AUTOMATIC_DISCOVERY_RANGE=range_)
    assert shared_memory(*ALONE, ROS_AUTOMATIC_DISCOVERY_RANGE=range_)


@pytest.mark.system
@pytest.mark.parametrize("range_", ["SUBNET", "LOCALHOST"])
def test_what_it_is_told_is_what_goes_over_the_wire(range_: str) -> None:
    wire = [*ALONE, sys.executable, "-m", "tests.rigs.rtps_wire", range_]
    done = subprocess.run(wire, cwd=ROOT, check=True, timeout=TIMEOUT_S, stdout=subprocess.PIPE)
    sent: dict[str, dict[str, int]] = json.loads(done.stdout)
    ours, ordinary = sent["configured"], sent["ordinary"]
    assert ours["messages"] >= 1
    # 50 ms in place of 3 s, and 0.5 s in place of 3 s, in the same time.
    assert ours["questions"] >= 10 * ordinary["questions"] > 0
    assert ours["announcements"] >= 3 * ordinary["announcements"] > 0


@pytest.mark.nightly
def test_it_hears_answers_although_each_program_answers_once(tmp_path: Path) -> None:
    quiet = tmp_path / "quiet.xml"
    quiet.write_text(QUIET)
    environment = {**os.environ, **LOCAL}
    peer = subprocess.Popen(
        [sys.executable, "-c", QUIET_PEER],
        env=environment | {ros_environment.PROFILES[HERE - 2]: str(quiet)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with peer:
        assert peer.stdout is not None
        assert peer.stdout.readline()
        # The first calls reach the peer; those to others keep Fast DDS from listening to it.
        others = ";".join(f"127.0.0.{number}" for number in range(2, 60))
        done = subprocess.run(
            [sys.executable, "-c", PARTICIPANTS],
            env=environment | {ros_environment.PEERS: others},
            check=True,
            timeout=TIMEOUT_S,
            stdout=subprocess.PIPE,
        )
        peer.kill()
    heard: list[bool] = json.loads(done.stdout)
    # On a busy machine some may still come too early.
    assert sum(heard) >= 0.75 * len(heard)


# What is to be said is said, but never floods the log, wherever it is.

# ROS's log files go elsewhere where their folder cannot be written.


def test_the_folder_is_that_of_rcl(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert usual_folder({}) == tmp_path / ".ros/log"
    assert usual_folder({"ROS_HOME": "/opt/r"}) == Path("/opt/r/log")
    assert usual_folder({"ROS_HOME": "/opt/r", "ROS_LOG_DIR": "~/logs"}) == tmp_path / "logs"


def test_a_folder_that_can_be_written_is_used(tmp_path: Path) -> None:
    environment = {"ROS_HOME": str(tmp_path / "ros")}
    assert ensure_log_folder(environment) == ""
    assert environment.keys() == {"ROS_HOME"}


def test_another_one_takes_the_place_of_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    # Below a file there is no folder, not even for root.
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    environment = {"ROS_HOME": str(in_the_way)}
    said = ensure_log_folder(environment)
    instead = Path(environment["ROS_LOG_DIR"])
    assert said.startswith(
        f"{in_the_way / 'log'} cannot be written; ROS's log files are in {instead}"
    )
    assert os.access(instead, os.W_OK)
    instead.rmdir()


# What is to be said is said, but never floods the log, nor is held back without a word.
class Recorder:
    """What a logger is asked to write."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.levels: list[str] = []

    def warning(self, message: str) -> bool:
        return self._take("warning", message)

    def info(self, message: str) -> bool:
        return self._take("info", message)

    def _take(self, level: str, message: str) -> bool:
        self.said.append(message)
        self.levels.append(level)
        return True

    @property
    def held_back(self) -> int:
        """How many lines are said to have been held back."""
        found = (re.search(r"\((\d+) lines were suppressed\)$", said) for said in self.said)
        return sum(int(match[1]) for match in found if match)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SetClock:
    clock = SetClock()
    monkeypatch.setattr(limited_log, "monotonic", clock)
    return clock


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def log(clock: SetClock, recorder: Recorder) -> LimitedLog:
    assert clock.now_s
    return LimitedLog(cast("RcutilsLogger", recorder))


def test_different_sentences_are_all_said(log: LimitedLog, recorder: Recorder) -> None:
    for sentence in "abc":
        log.warn(sentence)
    assert recorder.said == ["a", "b", "c"]


def test_a_sentence_is_said_once_a_minute(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    log.warn("a")
    clock.now_s += SAME_AGAIN_S - 0.001
    log.warn("a")
    assert recorder.said == ["a"]
    clock.now_s += 0.001
    log.warn("a")
    log.warn("a")
    assert recorder.said == ["a", "a (1 lines were suppressed)"]
    clock.now_s += SAME_AGAIN_S
    log.warn("a")
    assert recorder.said[2:] == ["a (1 lines were suppressed)"]


def test_repeating_a_sentence_does_not_put_off_its_next_time(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    for _ in range(int(SAME_AGAIN_S) + 1):
        log.warn("a")
        clock.now_s += 1.0
    assert len(recorder.said) == 2


def test_a_burst_is_cut_off_and_counted(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    for number in range(BURST + 30):
        log.warn(f"stream {number}")
    assert recorder.said == [f"stream {number}" for number in range(BURST)]
    clock.now_s += BURST_S - 0.001
    log.warn("too early")
    assert len(recorder.said) == BURST
    clock.now_s += 0.001
    log.warn("the next")
    assert recorder.said[-1] == "the next (31 lines were suppressed)"
    log.warn("and one more")
    assert recorder.said[-1] == "and one more"


def test_what_a_burst_held_back_can_still_be_said(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    for number in range(BURST + 1):
        log.warn(f"stream {number}")
    clock.now_s += BURST_S
    log.warn(f"stream {BURST}")
    assert recorder.said[-1] == f"stream {BURST} (1 lines were suppressed)"


def test_every_warning_of_every_thread_is_said_or_counted(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    different, repeats, count = BURST // 4, 5, 8

    def warn(who: int) -> None:
        for number in range(different * repeats):
            log.warn(f"{who}: {number % different}")

    threads = [threading.Thread(target=warn, args=(who,)) for who in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    clock.now_s += BURST_S
    log.warn("the last")
    assert len(recorder.said) == BURST + 1
    assert len(recorder.said) + recorder.held_back == count * different * repeats + 1


def test_what_is_no_warning_is_limited_too(log: LimitedLog, recorder: Recorder) -> None:
    log.inform("attached")
    log.inform("attached")
    log.warn("lost")
    assert recorder.said == ["attached", "lost (1 lines were suppressed)"]
    assert recorder.levels == ["info", "warning"]


@pytest.mark.nightly
def test_the_loggers_of_rclpy_write_it(ros: Ros, capfd: pytest.CaptureFixture[str]) -> None:
    log = LimitedLog(ros.node.get_logger())
    log.warn("100 % of {x} was lost")
    log.warn("100 % of {x} was lost")
    written = capfd.readouterr().err
    assert written.count("100 % of {x} was lost") == 1
    assert "WARN" in written
