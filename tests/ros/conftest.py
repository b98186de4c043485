"""The node as a process of its own, and a listener in the process of the tests."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import IO, Any

import numpy as np
import pylsl
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces import srv
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer

DEADLINE_S, QUEUE = 30.0, 20_000
NODE = "/lsl_to_ros"
OWN_TOPICS = ("/diagnostics", "/lsl_to_ros/streams")


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
        # Of its own: tests of other folders may run in this process, too.
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("listener", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Client] = {}
        self._heard: list[Subscription] = []
        self._timers: list[Timer] = []
        self._publishers: list[Publisher] = []
        self._status: dict[str, Status] = {}
        self._reported_ns = 0
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 100)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def until(self, holds: Callable[[], bool], expected: str) -> None:
        """Spin until *holds*; the test fails if it never does."""
        deadline = time.monotonic() + DEADLINE_S
        while not holds():
            assert time.monotonic() < deadline, f"never happened: {expected}"
            self._executor.spin_once(timeout_sec=0.05)

    def spin(self, seconds: float) -> None:
        """Spin for a time, in which something must not happen."""
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() >= end, "its end")

    def listen(self, kind: type[Any], topic: str, qos: QoSProfile | None = None) -> list[Any]:
        """Subscribe; the list fills with messages while the test waits."""
        messages: list[Any] = []
        profile = qos or QoSProfile(depth=QUEUE)
        self._heard.append(self.node.create_subscription(kind, topic, messages.append, profile))
        return messages

    def publish(
        self, make: Callable[[], Any], topic: str, qos: QoSProfile | int = 10, every_s: float = 0.05
    ) -> None:
        """Publish again and again while the test waits, until it ends."""
        first: Any = make()
        publisher = self.node.create_publisher(first.__class__, topic, qos)
        self._publishers.append(publisher)
        timer = self.node.create_timer(every_s, lambda: publisher.publish(make()))
        self._timers.append(timer)

    def stop_listening(self) -> None:
        """End what :meth:`listen` and :meth:`publish` have begun."""
        for timer in self._timers:
            self.node.destroy_timer(timer)
        for publisher in self._publishers:
            self.node.destroy_publisher(publisher)
        self._timers.clear()
        self._publishers.clear()
        for subscription in self._heard:
            self.node.destroy_subscription(subscription)
        self._heard.clear()

    def publishers(self, topic: str) -> list[Any]:
        """What DDS knows of each publisher of a topic (``TopicEndpointInfo``)."""
        node: Any = self.node
        return node.get_publishers_info_by_topic(topic)

    def topics(self) -> dict[str, list[str]]:
        """Message types by topic, of what is published or subscribed."""
        return dict(self.node.get_topic_names_and_types())

    def services(self, node: str) -> set[str]:
        """What a node offers."""
        listener: Any = self.node
        offered = listener.get_service_names_and_types_by_node(node, "/")
        return {name for name, _ in offered}

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

    def call(self, service: str, kind: type[Any], request: Any) -> Any:
        """Call a service; return the answer."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        client = self._clients[service]
        assert client.wait_for_service(timeout_sec=DEADLINE_S)
        answer = client.call_async(request)
        self.until(answer.done, f"an answer of {service}")
        return answer.result()

    def set(self, name: str, value: bool | float | str | None, node: str = NODE) -> str:
        """Set a parameter of a node; return the reason of a refusal, empty if accepted."""
        parameter = Parameter(name, value=value).to_parameter_msg()
        request = srv.SetParameters.Request(parameters=[parameter])
        (result,) = self.call(f"{node}/set_parameters", srv.SetParameters, request).results
        assert result.successful is not bool(result.reason)
        return result.reason

    def describe(self, *names: str) -> dict[str, Any]:
        """Descriptors of the node's parameters by name."""
        kind: type[Any] = vars(srv)["DescribeParameters"]
        request = kind.Request(names=list(names))
        answer = self.call(f"{NODE}/describe_parameters", kind, request)
        return dict(zip(names, answer.descriptors, strict=True))

    def _take(self, report: DiagnosticArray) -> None:
        stamp = report.header.stamp
        self._reported_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        self._status = {
            status.name.partition(": ")[2]: Status(
                status.level,
                status.message,
                status.hardware_id,
                {value.key: value.value for value in status.values},
            )
            for status in report.status
        }


class RunningNode:
    """The node, with everything that it writes."""

    def __init__(self, *arguments: str, module: str = "lsl_to_ros.node") -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
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
    def pid(self) -> int:
        return self._process.pid

    @property
    def log(self) -> str:
        return "".join(self._lines)

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    def count(self, *parts: str) -> int:
        """Count the lines of the log that contain all *parts*."""
        return sum(all(part in line for part in parts) for line in list(self._lines))

    def send(self, number: signal.Signals) -> None:
        """Send a signal that does not end it."""
        self._process.send_signal(number)

    def signal(self, number: signal.Signals) -> int:
        """Send a signal; return the exit code."""
        self.send(number)
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


class Flow:
    """Pushes 1, 2, 3, ... in a thread of its own, stamped evenly at the stream's rate."""

    def __init__(self, outlet: pylsl.StreamOutlet, rate: float) -> None:
        self.pushed = 0
        self._outlet = outlet
        self._rate = rate
        self._begun = pylsl.local_clock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._push, daemon=True)
        self._thread.start()

    def stop(self) -> int:
        """End; return how many samples there were."""
        self._stopping.set()
        self._thread.join()
        return self.pushed

    def stamp(self, number: float) -> float:
        """Return when the sample of that number is due, on the LSL clock."""
        return self._begun + number / self._rate

    def _push(self) -> None:
        while not self._stopping.wait(0.02):
            due = int((pylsl.local_clock() - self._begun) * self._rate)
            new = np.arange(self.pushed + 1, due + 1)
            if len(new):
                samples = new[:, np.newaxis].astype(np.float32)
                self._outlet.push_chunk(samples, [self.stamp(int(number)) for number in new])
                self.pushed = due


@pytest.fixture(scope="session")
def listener() -> Iterator[Ros]:
    listener = Ros()
    yield listener
    listener.close()


@pytest.fixture(scope="module")
def default_context() -> Iterator[None]:
    """The context of nodes that a test makes itself, as users do."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()


@pytest.fixture
def ros(listener: Ros, default_context: None) -> Iterator[Ros]:
    del default_context
    yield listener
    listener.stop_listening()


@pytest.fixture(scope="module")
def node(listener: Ros, request: pytest.FixtureRequest) -> Iterator[RunningNode]:
    """One node, with a module's ``NODE_ARGUMENTS``; none of its tests may end or break it."""
    # One that was killed stays in the graph until its lease is over.
    listener.until(
        lambda: not any(map(listener.publishers, OWN_TOPICS)), "the end of earlier nodes"
    )
    # By name: pytest leaves the type of a module open.
    running = RunningNode(*getattr(getattr(request, "module", None), "NODE_ARGUMENTS", ()))
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

    def start(*arguments: str, **options: str) -> RunningNode:
        started.append(RunningNode(*arguments, **options))
        return started[-1]

    yield start
    for running in started:
        running.end()


@pytest.fixture
def kept() -> Iterator[list[object]]:
    """Keep what is to end behind all flows: LSL has crashed where outlets end while others push."""
    held: list[object] = []
    yield held
    held.clear()


@pytest.fixture
def flow(kept: list[object]) -> Iterator[Callable[..., Flow]]:
    """Let samples flow until the end of the test."""
    begun: list[Flow] = []

    def begin(outlet: pylsl.StreamOutlet, rate: float) -> Flow:
        kept.append(outlet)
        begun.append(Flow(outlet, rate))
        return begun[-1]

    yield begin
    for one in begun:
        one.stop()


_numbers = count()
MakeNode = Callable[..., Node]


@pytest.fixture
def make_node(ros: Ros) -> Iterator[MakeNode]:
    """Make nodes with parameters, ``__`` in whose names stands for a dot."""
    assert ros is not None
    nodes: list[Node] = []

    def make(**overrides: Any) -> Node:
        given = [Parameter(name.replace("__", "."), value=v) for name, v in overrides.items()]
        node = Node(
            f"of_tests_{next(_numbers)}",
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
            parameter_overrides=given,
        )
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        node.destroy_node()
