"""One run of the whole chain that two programs record: a bag, and LabRecorder's XDF file."""

from __future__ import annotations

import signal
import socket
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity, StreamSpec
from biosensor_gateway.devices.registry import declaration
from tests.system import bag_reader, lab_recorder, lsl_sources
from tests.system.bag_reader import RecordedTopic
from tests.system.lab_recorder import RecordedStream
from tests.system.lsl_time import NS_PER_S, system_minus_lsl_ns
from tests.system.programs import Program
from tests.system.tracks import Track
from tests.system.workspace import Workspace

RECORD_S = 14.0
DEADLINE_S = 90.0
# The node looks for subscribers four times a second.
SUBSCRIBED_S = 1.0
# What comes shortly after LabRecorder has opened its streams may have been pushed before.
# It pulls twice a second, and what comes after its last pull is not in the file.
BEGIN_MARGIN_S = 1.0
END_MARGIN_S = 1.5

SENSORS = (
    "empatica_e4",
    "emotiv_insight",
    "shimmer3_gsr",
    "polar_h10",
    "vernier_respiration_belt",
    "zephyr",
    "ble_heart_rate",
)
_UNIT = "virtual"
# LabRecorder drops streams of 64-bit integers.
NOT_IN_XDF = tuple(spec for spec in lsl_sources.SPECS if spec.format == "int64")


@dataclass(frozen=True)
class RecordedRun:
    """What was recorded.

    Attributes
    ----------
    bag, xdf
        The two files.
    topics, streams
        By the name of the stamped topic: what the bag has, and what LabRecorder has.
    pushed
        All that the test itself has pushed of the streams that LabRecorder drops.
    both_ns
        System times between which both recorded for certain.
    """

    bag: Path
    xdf: Path
    topics: Mapping[str, RecordedTopic]
    streams: Mapping[str, RecordedStream]
    pushed: Mapping[str, Track]
    both_ns: tuple[int, int]


def declared() -> dict[str, StreamSpec]:
    """Return the streams of the virtual devices by their stamped topics."""
    return {
        f"/{naming.topic(DeviceIdentity(name, _UNIT), stream.data_name)}_stamped": stream
        for name in SENSORS
        for stream in declaration(name).streams
    }


def in_xdf() -> dict[str, str]:
    """Return the ``source_id`` of each stream that LabRecorder records, by stamped topic."""
    devices = {
        topic: naming.source_id(DeviceIdentity(topic.split("/")[-2], _UNIT), stream.data_name)
        for topic, stream in declared().items()
    }
    others = {spec.topic: spec.source_id for spec in lsl_sources.SPECS if spec not in NOT_IN_XDF}
    gateway = DeviceIdentity("gateway", socket.gethostname())
    agent = {
        f"/biosensors/gateway/{name}_stamped": naming.source_id(gateway, name)
        for name in ("events", "markers")
    }
    return devices | others | agent | {lsl_sources.BUTTON_TOPIC: lsl_sources.BUTTON_SOURCE_ID}


def record(folder: Path, workspace: Workspace) -> RecordedRun:
    """Run agent, other programs, node and both recorders, and read what they wrote.

    Raises
    ------
    AssertionError
        If a stamped topic does not appear, or a program fails; with what they said.
    """
    bag, xdf = folder / "bag", folder / "run.xdf"
    with ExitStack() as stack:
        programs = _Programs(folder, workspace, stack)
        node = programs.start("node", workspace.node)
        package = workspace.install / "biosensor_msgs" / "share" / "biosensor_msgs"
        # The tests' own interpreter has rosbags, and the messages come from the workspace.
        listening = (sys.executable, "-m", "tests.system.bag_recorder", str(bag), str(package))
        recorder = programs.start("recorder", *listening)
        agent_program = (sys.executable, "-m", "biosensor_gateway.cli", "run")
        running = (*agent_program, "--simulate", ",".join(SENSORS))
        agent = programs.start("agent", *running, is_ros=False)
        sources = stack.enter_context(lsl_sources.running())
        _wait_for_topics(recorder, {*in_xdf(), *(spec.topic for spec in NOT_IN_XDF)}, node)
        time.sleep(SUBSCRIBED_S)
        with lab_recorder.recording(xdf, in_xdf().values()):
            begin_ns = time.time_ns() + round(BEGIN_MARGIN_S * NS_PER_S)
            time.sleep(RECORD_S)
            end_ns = time.time_ns() - round(END_MARGIN_S * NS_PER_S)
        offset_ns = system_minus_lsl_ns()
        _end(recorder, signal.SIGTERM)
        _end(node, signal.SIGINT)
        _end(agent, signal.SIGINT)
    dropped = [source for source in sources if source.spec in NOT_IN_XDF]
    return RecordedRun(
        bag,
        xdf,
        topics=bag_reader.read(bag),
        streams=lab_recorder.read(xdf, offset_ns),
        pushed={source.spec.topic: source.track(offset_ns) for source in dropped},
        both_ns=(begin_ns, end_ns),
    )


class _Programs:
    """Starts programs that end with a block, at the latest."""

    def __init__(self, folder: Path, workspace: Workspace, stack: ExitStack) -> None:
        self._folder = folder
        self._environment = workspace.environment()
        self._stack = stack

    def start(self, name: str, *command: str, is_ros: bool = True) -> Program:
        """Start a program, in the environment of the workspace if it is one of ROS."""
        environment = self._environment if is_ros else None
        program = Program(command, self._folder / f"{name}.log", env=environment)
        self._stack.callback(program.end)
        return program


def _end(program: Program, number: signal.Signals) -> None:
    """End a program by a signal, cleanly."""
    program.process.send_signal(number)
    assert program.process.wait(DEADLINE_S) == 0, program.output


def _wait_for_topics(recorder: Program, topics: set[str], node: Program) -> None:
    """Wait until the recorder receives all topics, or for the deadline."""
    deadline = time.monotonic() + DEADLINE_S
    while True:
        missing = topics - {record.get("matched") for record in recorder.records}
        if not missing:
            return
        said = f"{recorder.output}{node.output}"
        assert time.monotonic() < deadline, f"no topic {sorted(missing)}:\n{said}"
        time.sleep(0.1)
