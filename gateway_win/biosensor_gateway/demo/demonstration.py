"""Runs agent, page, node and table as separate processes, as in a lab.

The declarations predict which topics are filled in the given time, and why others are not. Each
process has a log file, which is shown if the process ends early.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import (
    Callable,
    Collection,
    Container,
    Generator,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path

from biosensor_common.child import wait_or_kill
from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.process_limits import INTERRUPTED
from biosensor_common.spec import FromDevice, StreamSpec
from biosensor_gateway.demo.virtual_devices import virtual_class
from biosensor_gateway.devices.registry import declaration, sensor, sensor_names, settings_models
from biosensor_gateway.settings.file import load_or_defaults
from biosensor_gateway.settings.places import STATE_VARIABLE, settings_path
from biosensor_gateway.simulation.virtual_device import Filled, VirtualDevice
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.system.child import own_command
from biosensor_gateway.system.shutdown import requests_interrupt

# From the first sample of any device until every other one is found and connected.
CONNECT_S = 9.0
_AT_ONCE = Filled(0, "")


def demo_devices() -> dict[str, str]:
    """Return the virtual device of each sensor that has one, as ``run --simulate`` names it."""
    having = {name: sensor(name) for name in sensor_names()}
    return {
        name: f"{name}:{each.demo}" if each.demo else name
        for name, each in having.items()
        if each.demo in each.virtual
    }


def first_devices() -> dict[str, str]:
    """Return the virtual devices with which ``try`` begins; see `demo_devices`."""
    return {name: called for name, called in demo_devices().items() if sensor(name).introduces}


def fitting_devices(room: Room) -> tuple[dict[str, str], str]:
    """Return the devices whose streams fit into one process, and a sentence on the others."""
    devices = demo_devices()
    said = room.share_out({name: len(declaration(name).streams) for name in devices})
    return {name: called for name, called in devices.items() if room.has(name)}, said


def unfilled_streams(called: str, seconds: float) -> dict[str, str]:
    """Return why streams are still empty *seconds* after a device connected, by data name."""
    filled = virtual_class(called).filled
    reasons = {name: _reason(each, seconds) for name, each in filled.items()}
    return {name: reason for name, reason in reasons.items() if reason}


def expected_topics(
    seconds: float | None, chunk_length: int, devices: Container[str] | None = None
) -> dict[str, str]:
    """Return for each topic an empty text, or why it will receive nothing.

    Parameters
    ----------
    seconds
        Duration from the first sample of any device; None for no end.
    devices
        Sensors whose virtual devices run; None for all.
    """
    limit = float("inf") if seconds is None else seconds - CONNECT_S
    expected: dict[str, str] = {}
    for name, called in demo_devices().items():
        runs = devices is None or name in devices
        for topic, filled in _of_sensor(name, virtual_class(called), chunk_length).items():
            reason = _reason(filled, limit) if runs else "its device is left out"
            expected[f"/biosensors/{name}/{topic}"] = reason
    return expected


def _of_sensor(name: str, device: type[VirtualDevice], chunk_length: int) -> dict[str, Filled]:
    expected: dict[str, Filled] = {}
    for stream in declaration(name).streams:
        filled = device.filled.get(stream.data_name, _AT_ONCE)
        expected[stream.data_name] = filled
        if stream.chunk:
            expected[f"{stream.chunk}_chunk"] = _of_chunks(stream, device, filled, chunk_length)
    return expected


def _of_chunks(
    stream: StreamSpec, device: type[VirtualDevice], filled: Filled, chunk_length: int
) -> Filled:
    if filled.after_s is None:
        return filled
    said = device.rates_hz.get(stream.data_name)
    rate = said if isinstance(stream.rate, FromDevice) else stream.rate
    if not rate:
        return Filled(None, "its rate is not known")
    fill_s = chunk_length / rate
    return Filled(
        filled.after_s + fill_s, f"a chunk of {chunk_length} samples takes {fill_s:.1f} s"
    )


def _reason(filled: Filled, limit_s: float) -> str:
    if filled.after_s is None:
        return filled.reason
    return "" if filled.after_s <= limit_s else filled.reason


STOP_TIMEOUT_S = 3.0
"""How long all programs together may take to end before they are killed."""


def python_program(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module of this installation."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment(folder: Path) -> Mapping[str, str]:
    """Return environment variables with which programs write only to this folder.

    The user's agent may run at the same time with its own state folder. ROS is limited to this
    machine unless the user's environment says otherwise. No home folder is needed.
    """
    local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(folder / "ros")}
    return {**local, **os.environ, STATE_VARIABLE: str(state_of(folder))}


def state_of(folder: Path) -> Path:
    """Return the state folder of programs with this `environment`."""
    return folder / "state"


class Programs:
    """The programs of a try-out, by name, with their logs in a folder.

    Parameters
    ----------
    folder
        An existing folder; see `environment`.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.may_end: Collection[str] = ()  # Names of programs that a person may end.
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._killed_s: float | None = None

    @contextmanager
    def started(self, name: str, command: Sequence[str]) -> Generator[None]:
        """Run a program while the context lasts; the first that ends asks all to end."""
        with self._log(name).open("wb") as log:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment(self._folder),
            )
        self._running[name] = process
        try:
            yield
        finally:
            left_s = self.begin_to_end()
            del self._running[name]
            stop(process, left_s)

    def begin_to_end(self) -> float:
        """Ask all programs to end; return after how many seconds they are to be killed."""
        if self._killed_s is None:
            self._killed_s = time.monotonic() + STOP_TIMEOUT_S
            # On Windows each is asked to end by its own command first.
            for each in self._running.values() if sys.platform != "win32" else ():
                interrupt(each)
        return self._killed_s - time.monotonic()

    def has_ended(self, name: str) -> bool:
        """Whether a person has ended the program."""
        return name in self.may_end and self._running[name].poll() == 0

    def require_running(self) -> None:
        """Check that all programs run, except those that a person has ended.

        Raises
        ------
        TransportError
            ``ABSENT`` with the log of a program that has ended.
        """
        for name, process in self._running.items():
            if process.poll() is not None and not self.has_ended(name):
                log = self._log(name).read_text(encoding="utf-8", errors="replace")
                message = f"the {name} ended unexpectedly; its last output was:\n{log.rstrip()}"
                raise TransportError(TransportReason.ABSENT, message)

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"


def stop(process: subprocess.Popen[bytes], limit_s: float = STOP_TIMEOUT_S) -> None:
    """End a process, by SIGINT if the system has it, and wait for its end."""
    interrupt(process)
    wait_or_kill(process, max(0.0, limit_s))


def interrupt(process: subprocess.Popen[bytes]) -> None:
    """Ask a process to end, by SIGINT if the system has it."""
    if process.poll() is not None:
        return
    if sys.platform == "win32":
        process.terminate()
    else:
        process.send_signal(signal.SIGINT)


# Short enough that the slowest chunk, of the wristband's 4 Hz, fills in eight seconds.
CHUNK_LENGTH = 32
_POLL_S = 0.2
# Number of streams whose files the agent needs for its virtual devices instead.
_KEPT_STREAMS = 3


def run(seconds: float | None) -> int:
    """Run the demo; see the command line's help.

    Parameters
    ----------
    seconds
        Duration from the first sample; None to run until Ctrl-C.

    Returns
    -------
    int
        0 if every topic that the virtual devices can fill received data, 3 if the computer was too
        busy for some of them, 130 if it was interrupted before the table was shown, else 1.

    Raises
    ------
    TransportError
        ``UNAVAILABLE`` if this installation lacks rclpy; ``EXHAUSTED`` if the system's limit of
        open files is too low for any device; ``ABSENT`` if agent or node ends early.
    """
    if not has_ros():
        message = (
            "the demo needs rclpy: pip install 'biosensor-gateway[ros]' (Linux x86-64); without "
            "ROS there is: biosensor-gateway try"
        )
        raise TransportError(TransportReason.UNAVAILABLE, message)
    devices, left_out = fitting_devices(Room.here(_KEPT_STREAMS))
    if not devices:
        raise TransportError(TransportReason.EXHAUSTED, left_out)
    if left_out:
        sys.stderr.write(f"{left_out}\n")
    with requests_interrupt(), ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="biosensor-demo-")))
        programs = Programs(folder)
        stack.enter_context(programs.started("agent", agent_command(devices.values())))
        stack.enter_context(programs.started("node", node_command()))
        topics = expected_topics(seconds, CHUNK_LENGTH, devices)
        code = show_topics(seconds, topics, programs, folder)
    if left_out:
        sys.stderr.write(f"{left_out}\n")
    # Devices that are left out count as missing.
    return code or (1 if left_out else 0)


def has_ros() -> bool:
    """Whether this Python can run the node."""
    return find_spec("rclpy") is not None


def agent_command(devices: Iterable[str]) -> list[str]:
    """Return the command line of an agent with these virtual devices."""
    return own_command(["run", "--simulate", ",".join(devices)])


def node_command() -> list[str]:
    """Return the command line of a node that finds the agent."""
    return python_program("lsl_to_ros.node", "--ros-args", *_parameters())


def _parameters() -> Iterator[str]:
    yield from ("-p", f"Chunk_Length:={CHUNK_LENGTH}")
    # The node needs the LSL settings of the agent to find it.
    lsl = load_or_defaults(settings_path(), settings_models()).lsl
    if lsl.session_id:
        # Quoted, so that a session named 42 is not parsed as a number.
        yield from ("-p", f"session_id:={json.dumps(lsl.session_id)}")
    if lsl.known_peers:
        yield from ("-p", f"known_peers:={json.dumps(lsl.known_peers)}")


def show_topics(
    seconds: float | None,
    topics: Mapping[str, str],
    programs: Programs,
    folder: Path,
    is_over: Callable[[], bool] = lambda: False,
) -> int:
    """Draw the table of topics until Ctrl-C or the end; return its exit code, as `run` does.

    Parameters
    ----------
    seconds
        Duration from the first message; None to run until Ctrl-C.
    topics
        Expected topics; see `expected_topics`.
    programs
        Programs that have to run meanwhile.
    is_over
        Whether a person has ended the table in another way than by Ctrl-C.

    Raises
    ------
    TransportError
        ``ABSENT`` if one of the programs ends.
    """
    expected = folder / "expected.json"
    expected.write_text(json.dumps(topics), encoding="utf-8")
    options = ["--expect", str(expected)]
    if seconds is not None:
        options += ["--seconds", str(seconds)]
    # In a group of its own, so that Ctrl-C in its imports, which take seconds, is no traceback.
    table = subprocess.Popen(
        python_program("lsl_to_ros.live_table", *options),
        env=environment(folder),
        process_group=None if sys.platform == "win32" else 0,
    )
    try:
        while table.poll() is None and not is_over():
            programs.require_running()
            time.sleep(_POLL_S)
    except KeyboardInterrupt:
        limit_s = programs.begin_to_end()
        table.terminate()
        wait_or_kill(table, limit_s)
        if table.returncode == -signal.SIGTERM:
            # Otherwise the table has printed its summary.
            sys.stderr.write("Ended before the table was shown.\n")
            return INTERRUPTED
    finally:
        if table.poll() is None:
            table.terminate()
        wait_or_kill(table, STOP_TIMEOUT_S)
    # It may not have begun to handle signals when it was asked to end.
    return 0 if table.returncode == -signal.SIGTERM else table.returncode
