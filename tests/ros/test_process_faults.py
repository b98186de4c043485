"""Processes of the node that are killed, stand still, or cannot be as many as asked for."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32MultiArray

from lsl_to_ros.lsl.share import Share
from tests.rigs.lsl_streams import DEADLINE_S

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode, Status

pytestmark = pytest.mark.nightly

PROCESSES = 3
RATE_HZ = 100.0
SAID_OF_HUNG = (
    r"(?P<end>process 2 of 3 said nothing for 1\d s and was ended), and was started again \d+ s ago"
)

Start = Callable[..., "RunningNode"]

PARAMETERS = """
/lab/renamed:
  ros__parameters:
    processes: 2
    Chunk_Length: 3
    Chunk_Enabled: true
    topic_prefix: prefix
"""


def info(name: str) -> pylsl.StreamInfo:
    return pylsl.StreamInfo(name, "EEG", 1, RATE_HZ, "float32", name)


def for_process(index: int, word: str, processes: int = PROCESSES) -> str:
    """The first of some words that is the source_id of a stream of that process."""
    share = Share(index, processes)
    return next(name for name in (f"{word}{n}" for n in range(1000)) if share.has(info(name)))


def children_of(pid: int) -> list[int]:
    """Processes that a process has started and that have not ended."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        # A thread may end meanwhile.
        with suppress(FileNotFoundError, ProcessLookupError):
            found += map(int, (task / "children").read_text().split())
    return [child for child in found if is_alive(child)]


def is_alive(pid: int) -> bool:
    """Whether a process runs; not one that has ended and was not waited for."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in ("Z", "X")


def wait_for_end_of(pids: list[int]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while any(map(is_alive, pids)):
        assert time.monotonic() < deadline, "a process of the node is left"
        time.sleep(0.05)


@pytest.fixture
def start(ros: Ros, start_node: Start) -> Iterator[Start]:
    """Start a node of one's own, and leave no process of it behind."""
    ros.until(lambda: not ros.publishers("/diagnostics"), "the end of earlier nodes")
    pids: list[int] = []

    def start(processes: int, *arguments: str) -> RunningNode:
        node = start_node(*arguments)
        ros.until(lambda: len(children_of(node.pid)) == processes - 1, "further processes")
        pids.extend(children_of(node.pid))
        # Else the last report may be one of another node.
        ros.report()
        return node

    yield start
    for pid in pids:
        if is_alive(pid):
            os.kill(pid, signal.SIGKILL)


def arguments(processes: int | str = PROCESSES) -> tuple[str, ...]:
    return ("--ros-args", "-p", f"processes:={processes}")


def status(ros: Ros, name: str) -> Status:
    found = ros.status(name)
    assert found is not None
    return found


@pytest.mark.seam
def test_a_killed_process_comes_back_with_its_streams(
    ros: Ros, start: Start, flow: Callable[..., Flow]
) -> None:
    node = start(PROCESSES, *arguments())
    names = [for_process(index, "back") for index in range(PROCESSES)]
    topics = [f"/biosensors/{name}/EEG" for name in names]
    heard = [ros.listen(Float32MultiArray, topic) for topic in topics]
    chunks = ros.listen(Float32MultiArray, f"{topics[1]}_chunk")
    outlets = [pylsl.StreamOutlet(info(name)) for name in names]
    ros.attached(topics[0], topics[2], readers=1)
    ros.attached(topics[1], readers=2)
    flows = [flow(outlet, RATE_HZ) for outlet in outlets]
    ros.until(lambda: all(heard), "samples of all")
    assert ros.set("Chunk_Length", 5) == ""
    killed = int(status(ros, "process 1")["pid"])
    os.kill(killed, signal.SIGKILL)
    ros.until(lambda: status(ros, "process 1").level == DiagnosticStatus.ERROR, "it is said")
    said = status(ros, "process 1").message
    assert said.startswith("process 1 of 3 was ended by signal 9; it is ")
    assert said in status(ros, "node").message
    assert status(ros, topics[1]).level == DiagnosticStatus.STALE
    # Its log comes by another way.
    ros.until(lambda: node.count("[WARN]", "process 1 of 3 was ended by signal 9") == 1, "the log")
    heard[1].clear()
    chunks.clear()
    ros.until(lambda: len(heard[1]) > 0 and len(chunks) > 0, "its stream is back")
    # What was set while the node ran is set in the new process, too.
    assert [len(each.data) for each in chunks] == [5] * len(chunks)
    ros.until(lambda: status(ros, "process 1").level == DiagnosticStatus.WARN, "that is told")
    assert status(ros, "process 1")["restarts"] == "1"
    assert "was started again" in status(ros, "process 1").message
    ros.until(lambda: status(ros, topics[1]).level == DiagnosticStatus.OK, "all is well")
    assert ros.topics().keys() >= set(topics)
    pushed = [each.stop() for each in flows]
    for index in (0, 2):
        ros.until(lambda index=index: len(heard[index]) == pushed[index], "the others lost none")
    assert node.signal(signal.SIGTERM) == 0


def test_names_stay_while_a_process_is_started_again(ros: Ros, start: Start) -> None:
    start(PROCESSES, *arguments())
    sources = [for_process(index, "unit") for index in range(2)]
    streams = [pylsl.StreamInfo("twin", "EEG", 1, RATE_HZ, "float32", each) for each in sources]
    outlets = [pylsl.StreamOutlet(each) for each in streams]
    topics = [f"/biosensors/twin_{each}/EEG" for each in sources]
    ros.attached(*topics)
    os.kill(int(status(ros, "process 1")["pid"]), signal.SIGKILL)
    seen: set[str] = set()

    def is_back() -> bool:
        seen.update(ros.present())
        process, stream = ros.status("process 1"), ros.status(topics[1])
        is_there = stream is not None and stream.message != "no samples"
        return process is not None and process["restarts"] == "1" and is_there

    ros.until(is_back, "it is back")
    ros.spin(1.0)
    assert "/biosensors/twin/EEG" not in seen | ros.present()
    assert set(topics) <= ros.present()
    del outlets


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_killed_or_ended_the_node_leaves_no_process(start: Start, number: signal.Signals) -> None:
    node = start(PROCESSES, *arguments())
    children = children_of(node.pid)
    assert node.signal(number) == (-9 if number == signal.SIGKILL else 0)
    wait_for_end_of(children)
    assert "Traceback" not in node.log


def test_a_process_that_stands_still_is_told_and_may_go_on(ros: Ros, start: Start) -> None:
    node = start(PROCESSES, *arguments())
    ros.until(lambda: ros.status("process 2") is not None, "a report")
    ros.until(lambda: status(ros, "process 2")["streams"] != "", "it has reported")
    held = int(status(ros, "process 2")["pid"])
    os.kill(held, signal.SIGSTOP)
    ros.until(lambda: "has said nothing for" in status(ros, "process 2").message, "it is told")
    os.kill(held, signal.SIGCONT)
    ros.until(lambda: status(ros, "process 2").level == DiagnosticStatus.OK, "it goes on")
    assert status(ros, "process 2")["restarts"] == "0"
    os.kill(held, signal.SIGSTOP)
    assert node.signal(signal.SIGINT) == 0
    wait_for_end_of([held])


def test_a_process_that_hangs_is_replaced_and_does_not_hold_the_others(
    ros: Ros, start: Start, flow: Callable[..., Flow]
) -> None:
    node = start(PROCESSES, *arguments())
    names = [for_process(index, "hung") for index in range(PROCESSES)]
    topics = [f"/biosensors/{name}/EEG" for name in names]
    outlets = [pylsl.StreamOutlet(info(name)) for name in names]
    heard = [ros.listen(Float32MultiArray, topic) for topic in topics]
    ros.attached(*topics, readers=1)
    flows = [flow(outlet, RATE_HZ) for outlet in outlets]
    ros.until(lambda: all(heard), "samples of all")
    ros.until(lambda: status(ros, "process 2")["streams"] == "1", "it has reported")
    hung = int(status(ros, "process 2")["pid"])
    os.kill(hung, signal.SIGSTOP)
    ros.until(lambda: not is_alive(hung), "it is ended")
    heard[2].clear()
    ros.until(lambda: len(heard[2]) > 0, "its stream is back")
    ros.until(lambda: status(ros, "process 2").level == DiagnosticStatus.WARN, "that is told")
    said = re.fullmatch(SAID_OF_HUNG, status(ros, "process 2").message)
    assert said, status(ros, "process 2").message
    assert status(ros, "process 2")["restarts"] == "1"
    assert int(status(ros, "process 2")["pid"]) != hung
    assert said[0] in status(ros, "node").message
    ros.until(lambda: node.count("[WARN]", f"{said['end']}; its streams are not") == 1, "the log")
    pushed = [each.stop() for each in flows]
    for index in (0, 1):
        ros.until(lambda index=index: len(heard[index]) == pushed[index], "the others lost none")
    assert node.signal(signal.SIGTERM) == 0


@pytest.mark.parametrize("value", ["17", "two"])
def test_a_wrong_number_of_processes_is_refused_with_a_sentence(
    ros: Ros, start: Start, value: str
) -> None:
    node = start(1, *arguments(value))
    ros.report()
    assert node.count("[ERROR]") == 1
    assert node.count("processes must be a whole number from 1 to 16, not", "ignored") == 1
    assert status(ros, "node")["processes"] == "1"
    assert children_of(node.pid) == []
    assert node.signal(signal.SIGINT) == 0


def test_name_namespace_and_parameter_file_hold_in_every_process(
    ros: Ros, start: Start, tmp_path: Path
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(PARAMETERS)
    remappings = ("-r", "__node:=renamed", "-r", "__ns:=/lab")
    names = [for_process(index, "file", 2) for index in range(2)]
    moved = ("-r", f"renamed:prefix/{names[1]}/EEG:=/moved")
    node = start(2, "--ros-args", "--params-file", str(file), *remappings, *moved)
    outlets = [pylsl.StreamOutlet(info(name)) for name in names]
    first, second = f"/lab/prefix/{names[0]}/EEG", "/moved"
    ros.attached(first, second)
    chunks = [ros.listen(Float32MultiArray, f"/lab/prefix/{name}/EEG_chunk") for name in names]
    ros.attached(first, second, readers=1)
    for outlet in outlets:
        outlet.push_chunk([[1.0], [2.0], [3.0]])
    ros.until(lambda: all(chunks), "chunks")
    assert [list(each[0].data) for each in chunks] == [[1.0, 2.0, 3.0]] * 2
    (publisher,) = ros.publishers(second)
    assert (publisher.node_namespace, publisher.node_name) == ("/lab", "_renamed_1")
    assert ros.set("Chunk_Length", 4, "/lab/renamed") == ""
    # Of two processes with the same file, one says what is wrong with it.
    assert node.count("Chunk_Enabled") == 1
    assert node.signal(signal.SIGINT) == 0
