"""Threads share as many of glibc's arenas as they are told to, in real processes."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from biosensor_common.process_limits import ARENAS
from tests.rigs.arenas import count_arenas

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="glibc's arenas"),
]

THREADS = 6
# Threads that each take memory, hold it, and wait until all have.
PROGRAM = f"""
import ctypes, os, sys, threading
from biosensor_common.process_limits import limit_arenas
if sys.argv[1] == "limited":
    print(limit_arenas(os.environ), flush=True)
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
here = threading.Barrier({THREADS} + 1)
def take():
    libc.malloc(100_000)
    here.wait()
    here.wait()
threads = [threading.Thread(target=take) for _ in range({THREADS})]
for thread in threads:
    thread.start()
here.wait()
print("here", flush=True)
sys.stdin.read()
here.wait()
"""


def run(how: str, **environment: str) -> tuple[list[str], int]:
    """Return what the program says, and how many arenas it has."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, how],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )
    with process:
        assert process.stdout is not None
        assert process.stdin is not None
        said: list[str] = []
        while "here" not in said:
            said.append(process.stdout.readline().strip())
        arenas = count_arenas(process.pid)
        process.stdin.close()
    assert process.returncode == 0
    return said[:-1], arenas


def test_threads_share_as_many_arenas_as_are_allowed() -> None:
    # By default up to eight for each processor.
    assert run("as they like") == ([], 1 + THREADS)
    assert run("limited") == (["True"], ARENAS)


@pytest.mark.parametrize(
    ("name", "value"),
    [("MALLOC_ARENA_MAX", "5"), ("GLIBC_TUNABLES", "glibc.malloc.arena_max=5")],
)
def test_what_the_user_has_said_holds(name: str, value: str) -> None:
    assert run("limited", **{name: value}) == (["False"], 5)
