"""The pair end to end without hardware: virtual devices of every kind become topics.

Agent, node and table are processes of their own, as they are in a lab. The BioHarness
plays bytes that were recorded from a real one.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.demo.expectation import expected_topics, fitting_devices
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.settings.file import load_or_defaults
from biosensor_gateway.settings.places import STATE_VARIABLE, settings_path
from biosensor_gateway.streaming.room import Room

# Short enough that the slowest chunk, of the wristband's 4 Hz, fills in eight seconds.
CHUNK_LENGTH = 32
STOP_TIMEOUT_S = 10.0
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
        program open too few files for any device.
    """
    if find_spec("rclpy") is None:
        message = "the demo needs rclpy: pip install 'biosensor-gateway[ros]' (Linux x86-64)"
        raise TransportError(TransportReason.UNAVAILABLE, message)
    devices, left_out = fitting_devices(Room.here(_KEPT_STREAMS))
    if not devices:
        raise TransportError(TransportReason.EXHAUSTED, left_out)
    if left_out:
        sys.stderr.write(f"{left_out}\n")
    code = _show(seconds, devices)
    if left_out:
        sys.stderr.write(f"{left_out}\n")
    # Not all that there is was shown.
    return code or (1 if left_out else 0)


def _show(seconds: float | None, devices: Mapping[str, str]) -> int:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="biosensor-demo-")))
        expected = folder / "expected.json"
        topics = expected_topics(seconds, CHUNK_LENGTH, devices)
        expected.write_text(json.dumps(topics), encoding="utf-8")
        servers = {
            name: stack.enter_context(_process(name, command, folder))
            for name, command in programs(devices.values()).items()
        }
        options = ["--expect", str(expected)]
        if seconds is not None:
            options += ["--seconds", str(seconds)]
        table = subprocess.Popen(
            [sys.executable, "-P", "-m", "lsl_to_ros.live_table", *options],
            env=_environment(folder),
        )
        return _wait(table, servers, folder)


def programs(devices: Iterable[str]) -> dict[str, Sequence[str]]:
    """Return the command lines of agent and node, as modules with arguments."""
    return {
        "agent": ("biosensor_gateway.cli", "run", "--simulate", ",".join(devices)),
        "node": ("lsl_to_ros.node", "--ros-args", *_parameters()),
    }


def _parameters() -> Iterator[str]:
    yield from ("-p", f"Chunk_Length:={CHUNK_LENGTH}")
    # The agent takes part in LSL as the settings say, and the node is to find it.
    lsl = load_or_defaults(settings_path(), settings_models()).lsl
    if lsl.session_id:
        # Quoted, so that a session named 42 is no number.
        yield from ("-p", f"session_id:={json.dumps(lsl.session_id)}")
    if lsl.known_peers:
        yield from ("-p", f"known_peers:={json.dumps(lsl.known_peers)}")


@contextmanager
def _process(name: str, command: Sequence[str], folder: Path) -> Generator[subprocess.Popen[bytes]]:
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", *command],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=_environment(folder),
        )
        try:
            yield process
        finally:
            _stop(process)


def _environment(folder: Path) -> Mapping[str, str]:
    # A try-out stays on this machine unless the user says otherwise, and beside the user's
    # own agent, whose state folder is taken. It leaves nothing behind, nor needs a home folder.
    local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(folder / "ros")}
    return {**local, **os.environ, STATE_VARIABLE: str(folder / "state")}


def _wait(
    table: subprocess.Popen[bytes], servers: Mapping[str, subprocess.Popen[bytes]], folder: Path
) -> int:
    try:
        while table.poll() is None:
            for name, process in servers.items():
                if process.poll() is not None:
                    log = (folder / f"{name}.log").read_text(encoding="utf-8", errors="replace")
                    sys.stderr.write(f"{log}\nthe {name} ended unexpectedly; see above\n")
                    return 1
            time.sleep(_POLL_S)
    except KeyboardInterrupt:
        # The table got the same Ctrl-C and prints its summary.
        table.wait(STOP_TIMEOUT_S)
    finally:
        _stop(table)
    return table.returncode


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
