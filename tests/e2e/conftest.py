"""The real programs as processes, and a real subscriber in the test's own."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Generator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import pytest
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from tests.rigs.polling import wait_until

DEADLINE_S = 30.0


class Programs:
    """Starts our programs; all of them end with the test, and must end cleanly."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._processes: list[tuple[str, subprocess.Popen[bytes]]] = []

    def start(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        name = f"{module}-{len(self._processes)}"
        log = (self._folder / f"{name}.log").open("wb")
        with log:
            process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        self._processes.append((name, process))
        return process

    def agent(self, settings: str) -> subprocess.Popen[bytes]:
        path = self._folder / "settings.toml"
        path.write_text(settings)
        return self.start("biosensor_gateway.cli", "run", "--settings", str(path))

    def node(self, *parameters: str) -> subprocess.Popen[bytes]:
        options = [option for parameter in parameters for option in ("-p", parameter)]
        return self.start("lsl_to_ros.node", "--ros-args", *options)

    def log(self, process: subprocess.Popen[bytes]) -> str:
        (name,) = (name for name, known in self._processes if known is process)
        return (self._folder / f"{name}.log").read_text(errors="replace")

    def status(self) -> dict[str, Any]:
        command = [sys.executable, "-m", "biosensor_gateway.cli", "status", "--json"]
        return json.loads(subprocess.run(command, capture_output=True, check=True).stdout)

    def interrupt(self, process: subprocess.Popen[bytes]) -> None:
        """End one of them."""
        process.send_signal(signal.SIGINT)
        process.wait(DEADLINE_S)

    def stop_all(self) -> None:
        for _, process in self._processes:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        try:
            codes = {name: self._ended(process) for name, process in self._processes}
        finally:
            for _, process in self._processes:
                process.kill()
                process.wait()
        assert set(codes.values()) <= {0}, (codes, [self.log(p) for _, p in self._processes])

    def _ended(self, process: subprocess.Popen[bytes]) -> int:
        try:
            return process.wait(DEADLINE_S)
        except subprocess.TimeoutExpired:
            # What each of its threads does then stands at the end of its log.
            process.send_signal(signal.SIGABRT)
            process.wait(DEADLINE_S)
            pytest.fail(f"not ended within {DEADLINE_S:.0f} s: {self.log(process)}")


@pytest.fixture
def programs(tmp_path: Path) -> Generator[Programs]:
    running = Programs(tmp_path)
    yield running
    running.stop_all()


class Message(Protocol):
    data: Any
    layout: Any


class Listener:
    """Subscribes in this process; one thread receives."""

    def __init__(self) -> None:
        # Of its own: tests of other folders may run in this process, too.
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("listener", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._stopping.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def listen(self, message_type: type[Any], topic: str) -> list[Any]:
        received: list[Any] = []
        take = partial(list[Any].append, received)
        self.node.create_subscription(message_type, topic, take, QoSProfile(depth=20_000))
        return received

    def set_parameters(self, node: str, values: dict[str, Any]) -> Sequence[Any]:
        client = self.node.create_client(SetParameters, f"/{node}/set_parameters")
        assert client.wait_for_service(timeout_sec=DEADLINE_S)
        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        future = client.call_async(SetParameters.Request(parameters=parameters))
        wait_until(future.done, f"parameters {values}")
        return future.result().results

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def listener() -> Generator[Listener]:
    running = Listener()
    yield running
    running.stop()
