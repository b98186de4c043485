"""What a unit test may not use is refused with a sentence, also where the refusal is swallowed."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pylsl
import pytest

from tests.tiers.guard import GUARD, NotInUnitTestError

ROOT = Path(__file__).parents[2]
INFO = pylsl.StreamInfo("guarded", "Test", 1, 0.0, "float32", "guarded")


def _join_a_thread() -> None:
    go_on = threading.Event()
    thread = threading.Thread(target=go_on.wait)
    thread.start()
    try:
        thread.join(0.01)
    finally:
        go_on.set()
        thread.join()


def _sleep_in_a_real_loop() -> None:
    with asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
        runner.run(asyncio.sleep(0.01))


def _start_a_ros_context() -> None:
    import rclpy  # noqa: PLC0415 - wheels of it are for one system
    from rclpy.context import Context  # noqa: PLC0415

    rclpy.init(args=[], context=Context())


WITH_ROS = pytest.mark.skipif(find_spec("rclpy") is None, reason="rclpy is not installed")
ON_POSIX = pytest.mark.skipif(sys.platform == "win32", reason="Windows has none")
FORBIDDEN: dict[str, Callable[[], object]] = {
    "a socket": socket.socket,
    "a child process": lambda: subprocess.run([sys.executable, "-c", ""], check=True),
    "time.sleep of up to 0.01 s": lambda: time.sleep(0.01),
    "a wait for another thread of up to 0.01 s": lambda: threading.Event().wait(0.01),
    "a wait for the end of a thread of up to 0.01 s": _join_a_thread,
    "a wait of an event loop of up to": _sleep_in_a_real_loop,
    "an LSL outlet": lambda: pylsl.StreamOutlet(INFO),
    "an LSL inlet": lambda: pylsl.StreamInlet(INFO),
    "an LSL resolver": lambda: pylsl.resolve_streams(0.0),
}


@pytest.mark.parametrize(
    ("what", "use"),
    [
        *FORBIDDEN.items(),
        pytest.param("a pseudo-terminal", getattr(os, "openpty", None), marks=ON_POSIX),
        pytest.param(
            "a child process",
            lambda: multiprocessing.get_context("spawn").Process(target=print).start(),
            marks=ON_POSIX,
        ),
        pytest.param("a ROS context", _start_a_ros_context, marks=WITH_ROS),
    ],
)
def test_what_a_unit_test_may_not_use_is_refused(
    request: pytest.FixtureRequest, what: str, use: Callable[[], object]
) -> None:
    with pytest.raises(NotInUnitTestError, match=what):
        use()
    # Taken back, else it would fail this test as it fails others.
    refused = GUARD.end()
    GUARD.begin(request.node.nodeid)
    assert refused
    assert "mark the test 'seam' or 'nightly'" in refused[0]


def test_what_a_unit_test_may_use_is_not_refused() -> None:
    time.sleep(0)
    assert time.monotonic() <= time.monotonic()
    assert pylsl.local_clock() > 0
    done = threading.Thread(target=print)
    done.start()
    done.join()
    asyncio.SelectorEventLoop().close()


BREAKS_THE_RULE = """
import socket

def test_that_swallows_the_refusal():
    try:
        socket.socket()
    except Exception:
        pass
"""


@pytest.mark.seam
def test_a_refusal_that_is_swallowed_fails_the_test(tmp_path: Path) -> None:
    broken = tmp_path / "test_broken.py"
    broken.write_text(BREAKS_THE_RULE)
    command = [sys.executable, "-m", "pytest", "-p", "tests.tiers.plugin", "-c", os.devnull]
    done = subprocess.run(
        [*command, "--rootdir", str(tmp_path), str(broken)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "is a unit test and used a socket" in done.stdout
