"""The node as a process of its own, and a listener in the process of the tests."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import IO, Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

DEADLINE_S = 30.0
QUEUE = 20_000


@dataclass(frozen=True, slots=True)
class Status:
    """One stream's entry in ``/diagnostics``."""

    level: bytes
    message: str
    unit: str
    values: dict[str, str]

    def __getitem__(self, key: str) -> str:
        return self.values[key]


class Ros:
    """Subscribes, and spins only while a test waits for something."""

    def __init__(self) -> None:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("listener")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._set = self.node.create_client(SetParameters, "/lsl_to_ros/set_parameters")
        self._heard: list[Subscription] = []
        self._status: dict[str, Status] = {}
        self._reported_ns = 0
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 100)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown()

    def until(self, holds: Callable[[], bool], expected: str) -> None:
        """Spin until *holds*; the test fails if it never does."""
        deadline = time.monotonic() + DEADLINE_S
        while not holds():
            assert time.monotonic() < deadline, f"never happened: {expected}"
            self._executor.spin_once(timeout_sec=0.05)

    def listen(self, kind: type[Any], topic: str) -> list[Any]:
        """Subscribe; the list fills with messages while the test waits."""
        messages: list[Any] = []
        qos = QoSProfile(depth=QUEUE)
        self._heard.append(self.node.create_subscription(kind, topic, messages.append, qos))
        return messages

    def stop_listening(self) -> None:
        """End what :meth:`listen` has begun."""
        for subscription in self._heard:
            self.node.destroy_subscription(subscription)
        self._heard.clear()

    def topics(self) -> dict[str, list[str]]:
        """Message types by topic, of what is published or subscribed."""
        return dict(self.node.get_topic_names_and_types())

    def status(self, topic: str) -> Status | None:
        """The latest report's entry of that topic."""
        return self._status.get(topic)

    def present(self) -> set[str]:
        """Topics in the latest report."""
        return set(self._status)

    def report(self) -> None:
        """Wait for a report that was begun after this call."""
        begun = time.time_ns()
        self.until(lambda: self._reported_ns >= begun, "a report on /diagnostics")

    def attached(self, *topics: str, readers: int = 0) -> None:
        """Wait until the node has these streams, each with so many subscribers of its topics."""
        begun = time.time_ns()

        def are_attached() -> bool:
            found = [self.status(topic) for topic in topics]
            return self._reported_ns >= begun and all(
                status is not None and status["subscribers"] == str(readers) for status in found
            )

        self.until(are_attached, f"{topics} with {readers} subscribers")

    def set(self, name: str, value: bool | float | str) -> str:
        """Set a parameter of the node; return the reason of a refusal, empty if accepted."""
        assert self._set.wait_for_service(timeout_sec=DEADLINE_S)
        parameter = Parameter(name, value=value).to_parameter_msg()
        answer = self._set.call_async(SetParameters.Request(parameters=[parameter]))
        self.until(answer.done, f"an answer for {name}")
        (result,) = answer.result().results
        assert result.successful is not bool(result.reason)
        return result.reason

    def _take(self, report: DiagnosticArray) -> None:
        stamp = report.header.stamp
        self._reported_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        self._status = {
            status.name.removeprefix("lsl_to_ros: "): Status(
                status.level,
                status.message,
                status.hardware_id,
                {value.key: value.value for value in status.values},
            )
            for status in report.status
        }


class RunningNode:
    """The node, with everything that it writes."""

    def __init__(self, *arguments: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "lsl_to_ros.node", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._lines: list[str] = []
        assert self._process.stdout is not None
        self._reader = threading.Thread(
            target=self._drain, args=(self._process.stdout,), daemon=True
        )
        self._reader.start()

    @property
    def log(self) -> str:
        return "".join(self._lines)

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    def count(self, *parts: str) -> int:
        """Count the lines of the log that contain all *parts*."""
        return sum(all(part in line for part in parts) for line in list(self._lines))

    def signal(self, number: signal.Signals) -> int:
        """Send a signal; return the exit code."""
        self._process.send_signal(number)
        return self.wait()

    def wait(self) -> int:
        code = self._process.wait(DEADLINE_S)
        self._reader.join(DEADLINE_S)
        return code

    def end(self) -> None:
        """End the process if it still runs."""
        if self.is_running:
            self._process.terminate()
            try:
                self.wait()
            except subprocess.TimeoutExpired:
                self._process.kill()
                self.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()

    def _drain(self, stream: IO[str]) -> None:
        for line in stream:
            self._lines.append(line)


@pytest.fixture(scope="session")
def listener() -> Iterator[Ros]:
    listener = Ros()
    yield listener
    listener.close()


@pytest.fixture
def ros(listener: Ros) -> Iterator[Ros]:
    yield listener
    listener.stop_listening()


@pytest.fixture(scope="module")
def node(listener: Ros) -> Iterator[RunningNode]:
    """One node for all tests of a module; none of them may end it or break it."""
    running = RunningNode()
    listener.report()
    yield running
    died, log = not running.is_running, running.log
    running.end()
    assert not died, log
    assert "Traceback" not in running.log


@pytest.fixture
def start_node() -> Iterator[Callable[..., RunningNode]]:
    """Start a node of one's own, in a module that does not use the shared one."""
    started: list[RunningNode] = []

    def start(*arguments: str) -> RunningNode:
        started.append(RunningNode(*arguments))
        return started[-1]

    yield start
    for running in started:
        running.end()
