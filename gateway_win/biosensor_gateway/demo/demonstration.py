"""Runs agent, page, node and table as processes of their own, as they are in a lab.

What they say goes to a log file each, and is shown if one of them ends before its time.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path

from biosensor_common.child import wait_or_kill
from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.demo.expectation import expected_topics, fitting_devices
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.settings.file import load_or_defaults
from biosensor_gateway.settings.places import STATE_VARIABLE, settings_path
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.system.child import own_command

STOP_TIMEOUT_S = 10.0


def python_program(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module of this installation."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment(folder: Path) -> Mapping[str, str]:
    """Return the variables of programs that leave nothing behind but in this folder.

    A try-out stays on this machine unless the user says otherwise, and beside the user's own
    agent, whose state folder is taken. It needs no home folder.
    """
    local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(folder / "ros")}
    return {**local, **os.environ, STATE_VARIABLE: str(state_of(folder))}


def state_of(folder: Path) -> Path:
    """Return the state folder of the programs that have this `environment`."""
    return folder / "state"


class Programs:
    """The programs of a try-out, by name, with their logs in a folder.

    Parameters
    ----------
    folder
        Is there; see `environment`.

    Attributes
    ----------
    may_end
        Names of those that a person may end.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.may_end: Collection[str] = ()
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    @contextmanager
    def started(self, name: str, command: Sequence[str]) -> Generator[None]:
        """Run a program while the context lasts."""
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
            del self._running[name]
            stop(process)

    def has_ended(self, name: str) -> bool:
        """Whether a person has ended it."""
        return name in self.may_end and self._running[name].poll() == 0

    def require_running(self) -> None:
        """See that none of them has ended but those that a person has ended.

        Raises
        ------
        TransportError
            ``ABSENT``, with what the one that ended has said.
        """
        for name, process in self._running.items():
            if process.poll() is not None and not self.has_ended(name):
                log = self._log(name).read_text(encoding="utf-8", errors="replace")
                message = f"the {name} ended unexpectedly; it had said:\n{log.rstrip()}"
                raise TransportError(TransportReason.ABSENT, message)

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"


def stop(process: subprocess.Popen[bytes]) -> None:
    """End a process, as Ctrl-C does where that can be sent, and wait for it."""
    if process.poll() is None:
        if sys.platform == "win32":
            process.terminate()
        else:
            process.send_signal(signal.SIGINT)
        wait_or_kill(process, STOP_TIMEOUT_S)


# Short enough that the slowest chunk, of the wristband's 4 Hz, fills in eight seconds.
CHUNK_LENGTH = 32
_POLL_S = 0.2
# In whose place the agent has the files of its virtual devices.
_KEPT_STREAMS = 3


def run(seconds: float | None) -> int:
    """Run the demo; see the command line's help.

    Parameters
    ----------
    seconds
        Counted from the first sample; None runs until Ctrl-C.

    Returns
    -------
    int
        0 if every topic that the virtual devices can fill received data, 3 if the computer is too
        busy for some of them so far, else 1.

    Raises
    ------
    TransportError
        ``UNAVAILABLE``, if this installation lacks rclpy; ``EXHAUSTED``, if the system lets a
        program open too few files for any device; ``ABSENT``, if agent or node ends too early.
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
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="biosensor-demo-")))
        programs = Programs(folder)
        stack.enter_context(programs.started("agent", agent_command(devices.values())))
        stack.enter_context(programs.started("node", node_command()))
        topics = expected_topics(seconds, CHUNK_LENGTH, devices)
        code = show_topics(seconds, topics, programs, folder)
    if left_out:
        sys.stderr.write(f"{left_out}\n")
    # Not all that there is was shown.
    return code or (1 if left_out else 0)


def has_ros() -> bool:
    """Whether this Python can run the node."""
    return find_spec("rclpy") is not None


def agent_command(devices: Iterable[str]) -> list[str]:
    """Return the command line of an agent with these virtual devices."""
    return own_command(["run", "--simulate", ",".join(devices)])


def node_command() -> list[str]:
    """Return the command line of a node that finds it."""
    return python_program("lsl_to_ros.node", "--ros-args", *_parameters())


def _parameters() -> Iterator[str]:
    yield from ("-p", f"Chunk_Length:={CHUNK_LENGTH}")
    # The agent takes part in LSL as the settings say, and the node is to find it.
    lsl = load_or_defaults(settings_path(), settings_models()).lsl
    if lsl.session_id:
        # Quoted, so that a session named 42 is no number.
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
        Counted from the first message; None runs until Ctrl-C.
    topics
        What is expected of each; see `expected_topics`.
    programs
        What has to run meanwhile.
    folder
        Theirs.
    is_over
        Whether a person has ended it in another way than by Ctrl-C.

    Raises
    ------
    TransportError
        ``ABSENT``, if one of them ends.
    """
    expected = folder / "expected.json"
    expected.write_text(json.dumps(topics), encoding="utf-8")
    options = ["--expect", str(expected)]
    if seconds is not None:
        options += ["--seconds", str(seconds)]
    table = subprocess.Popen(
        python_program("lsl_to_ros.live_table", *options), env=environment(folder)
    )
    try:
        while table.poll() is None and not is_over():
            programs.require_running()
            time.sleep(_POLL_S)
    except KeyboardInterrupt:
        # The table got the same Ctrl-C and prints its summary.
        table.wait(STOP_TIMEOUT_S)
    finally:
        stop(table)
    return table.returncode
