"""What happens in a lab of many computers, and what came of every stream, where.

Three receive all streams of four agents: two robots, each a node with a subscriber, and
LabRecorder. The subscriber of the second robot is on the desk, where LabRecorder is.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sysconfig
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.registry import declaration
from tests.rigs.hosts import completeness
from tests.rigs.hosts.completeness import Recording, Span
from tests.rigs.hosts.programs import Program, SteeredProgram
from tests.rigs.hosts.sites import (
    DEADLINE_S,
    DESK,
    PCS,
    ROBOTS,
    Setting,
    Sites,
    participant,
    unix_s,
)
from tests.rigs.lab_recorder import LabRecorder

CUT_OFF, KILLED = "pc-2", "pc-3"
RECORDER = "LabRecorder"
# Longer than LSL's resolver remembers what it does not see, which is 5 s in the node.
CUT_S = 6.0
# TCP tries again after 6.3 s, and after 12.7 s where it had begun early.
HEALED_S = 10.0
CALM_S = 4.0
_MEASURED_S = 4.0
# What has waited in a new node comes within this time.
_SETTLED_S = 3.0
_GATEWAY_STREAMS = len(declaration("gateway").streams)
Facts = dict[str, dict[str, str]]


class Stream(NamedTuple):
    """One stream of a device, which is worn by the person of a computer."""

    pc: str
    sensor: str
    data_name: str

    @property
    def identity(self) -> DeviceIdentity:
        return DeviceIdentity(self.sensor, self.sensor.upper(), participant(self.pc))

    @property
    def topic(self) -> str:
        return f"/{naming.topic(self.identity, self.data_name)}"

    @property
    def source_id(self) -> str:
        return naming.source_id(self.identity, self.data_name)


class Moments(NamedTuple):
    """Unix times."""

    # Before anything happened; after cut and kill of an agent; after the kill of a node.
    calm: tuple[Span, Span, Span]
    # cut, agent_dead, node_dead: from the fault to the time at which all was back.
    cut: Span
    agent_dead: Span
    node_dead: Span


class Robot(NamedTuple):
    """What the subscriber of a robot got, and how long its node took to find all streams."""

    topics: dict[str, Recording]
    diagnostics: list[tuple[float, Facts]]
    found_s: float

    def facts_at(self, time_s: float) -> Facts:
        """Return the first diagnostics that came from a time on."""
        return next(facts for came, facts in self.diagnostics if came >= time_s)


class Outcome(NamedTuple):
    """All of it; `truth` is what each device has sent."""

    streams: Sequence[Stream]
    truth: Mapping[Stream, Recording]
    robots: Mapping[str, Robot]
    xdf: Path
    recorder_found_s: float
    moments: Moments


class Happening:
    """Lets it happen in a lab that runs."""

    def __init__(self, sites: Sites, setting: Setting, folder: Path, stack: ExitStack) -> None:
        self._sites, self._setting, self._folder, self._stack = sites, setting, folder, stack
        self._streams: list[Stream] = []
        self._watchers: dict[str, SteeredProgram] = {}
        self._nodes: dict[str, Program] = {}
        self._ros: dict[str, dict[str, str]] = {}
        self._found_s: dict[str, float] = {}

    def run(self, sensors: Mapping[str, Sequence[str]]) -> Outcome:
        self._streams = [
            Stream(pc, sensor, stream.data_name)
            for pc in PCS
            for sensor in sensors[pc]
            for stream in declaration(sensor).streams
        ]
        for robot, host in zip(ROBOTS, (ROBOTS[0], DESK), strict=True):
            self._watch(robot, host)
        self._sites.await_streaming()
        path, begin_s = self._folder / "lab.xdf", time.monotonic()
        count = len(self._streams) + len(PCS) * _GATEWAY_STREAMS
        environment = self._sites.recorder_environment(DESK)
        recorder = LabRecorder(
            path, at_least=count, computer=self._sites[DESK], environment=environment
        )
        with recorder:
            recorder_found_s = time.monotonic() - begin_s
            for robot in ROBOTS:
                self._start_node(robot)
            self._await_all(ROBOTS, since_s=0.0)
            moments = self._disturb()
        robots = {robot: self._fetch(robot) for robot in ROBOTS}
        for node in self._nodes.values():
            # On a busy computer one takes over half a minute to end, of which this is no test.
            node.kill()
        return Outcome(self._streams, self._truth(), robots, path, recorder_found_s, moments)

    def _watch(self, robot: str, host: str) -> None:
        # Both publish the same streams, so they are in domains of their own.
        domain = {"ROS_DOMAIN_ID": str(1 + ROBOTS.index(robot))}
        if robot == ROBOTS[1] and self._setting.is_deaf:
            command, client = self._sites.discovery_server()
            domain |= client
            self._stack.enter_context(_running(self._sites[robot].command(*command)))
        self._ros[robot] = domain
        # A client of the server sees all topics only as a super client.
        environment = {**self._sites.environment(host), **domain, "ROS_SUPER_CLIENT": "TRUE"}
        place = self._folder / f"watch-{robot}"
        place.mkdir()
        watcher = SteeredProgram(
            self._sites[host], environment, place, "tests.rigs.hosts.subscriber"
        )
        self._watchers[robot] = self._stack.enter_context(watcher)

    def _start_node(self, robot: str) -> None:
        environment = {**self._sites.environment(robot), **self._ros[robot]}
        peers = ",".join(self._sites.peers(robot))
        options = ("--ros-args", "-p", f"known_peers:=[{peers}]") if peers else ()
        node = Program(
            self._sites[robot], environment, self._folder / robot, "lsl_to_ros.node", *options
        )
        self._found_s[robot] = -time.time()
        self._nodes[robot] = self._stack.enter_context(node)

    def _await_all(self, robots: Sequence[str], since_s: float) -> None:
        """Wait until each node has all streams and each topic its reader.

        Parameters
        ----------
        since_s
            The diagnostics are newer than this Unix time.
        """
        end = time.monotonic() + DEADLINE_S
        wanted = {stream.topic for stream in self._streams}
        waiting = list(robots)
        while waiting:
            for robot in list(waiting):
                state = self._watchers[robot].ask("state")
                facts: Facts = state["diagnostics"]
                came = state["diagnosed_s"] >= since_s and wanted <= facts.keys()
                if came and self._found_s[robot] < 0:
                    self._found_s[robot] += state["diagnosed_s"]
                read = came and all(int(facts[each]["subscribers"]) > 0 for each in wanted)
                if read and wanted <= set(state["matched"]):
                    waiting.remove(robot)
            if time.monotonic() > end:
                words = "\n".join(self._nodes[robot].last_words for robot in waiting)
                raise TimeoutError(f"{waiting} have not found all {len(wanted)} streams\n{words}")
            time.sleep(0.2)

    def _disturb(self) -> Moments:
        # LabRecorder measures the clocks after five seconds for the first time.
        time.sleep(_MEASURED_S)
        first = self._calm()
        cut_s = time.time()
        self._sites.unplug(CUT_OFF)
        time.sleep(CUT_S)
        self._sites.plug_in(CUT_OFF)
        healed_s = time.time() + HEALED_S
        agent_dead = self._kill_agent()
        time.sleep(max(0.0, healed_s - time.time()))
        second = self._calm()
        node_dead = self._kill_node(ROBOTS[1])
        return Moments((first, second, self._calm()), Span(cut_s, healed_s), agent_dead, node_dead)

    def _calm(self) -> Span:
        begin_s = time.time()
        time.sleep(CALM_S)
        return Span(begin_s, time.time())

    def _kill_agent(self) -> Span:
        killed_s = time.time()
        dead = self._sites.serving(KILLED)
        os.kill(dead, signal.SIGKILL)
        while self._sites.serving(KILLED) == dead:
            time.sleep(0.1)
        self._sites.await_streaming()
        # Its first samples wait until receivers are back, at most so long.
        time.sleep(5.0)
        return Span(killed_s, time.time())

    def _kill_node(self, robot: str) -> Span:
        killed_s = time.time()
        found_s = self._found_s[robot]
        self._nodes[robot].kill()
        self._start_node(robot)
        self._await_all([robot], since_s=time.time() + 1.0)
        self._found_s[robot] = found_s
        dead = Span(killed_s, time.time())
        time.sleep(_SETTLED_S)
        return dead

    def _truth(self) -> dict[Stream, Recording]:
        sent: dict[Stream, Recording] = {}
        for pc in PCS:
            for sensor in dict.fromkeys(s.sensor for s in self._streams if s.pc == pc):
                for data_name, samples in self._sites.truth(pc, sensor).items():
                    arrivals = unix_s(pc, samples.times)
                    rows = samples.values.astype("f4")
                    sent[Stream(pc, sensor, data_name)] = Recording(arrivals, arrivals, rows)
        return sent

    def _fetch(self, robot: str) -> Robot:
        path = self._folder / f"{robot}.npz"
        self._watchers[robot].ask("save", path=str(path))
        diagnostics = json.loads(path.with_suffix(".json").read_text())
        return Robot(
            completeness.load(path), [(came, facts) for came, facts in diagnostics],
            self._found_s[robot],
        )  # fmt: skip


@contextmanager
def _running(command: list[str]) -> Generator[None]:
    """Run the discovery server, whose libraries are those of the wheels."""
    folders = [Path(sysconfig.get_path("data")) / "lib"]
    folders += Path(sysconfig.get_path("platlib")).glob("ros_fastrtps.libs")
    libraries = {"LD_LIBRARY_PATH": os.pathsep.join(map(str, folders))}
    with subprocess.Popen(
        command, env={**os.environ, **libraries}, stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        try:
            yield
        finally:
            process.kill()


def run(setting: Setting, sensors: Mapping[str, Sequence[str]], folder: Path) -> Outcome:
    """Let it all happen once."""
    with Sites(setting, sensors, [KILLED], folder) as sites, ExitStack() as stack:
        return Happening(sites, setting, folder, stack).run(sensors)
