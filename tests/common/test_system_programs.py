"""Programs that are started, limits of processes, files that cannot be written, light imports."""

from __future__ import annotations

import ast
import errno
import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import pytest

import biosensor_common
from biosensor_common import process_limits
from biosensor_common.child import full_path, output_of
from biosensor_common.errors import TransportError, TransportReason, cannot_write
from biosensor_common.nonblocking_writer import NO_NETWORK, NonblockingWriter, Relay
from biosensor_common.process_limits import (
    ARENAS,
    INLET,
    MOST,
    OUTLET,
    RESERVE,
    fitting,
    wanted_limits,
)
from tests.rigs.processes import count_arenas

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = ("common", "gateway_win", "ros_side/lsl_to_ros/lsl_to_ros")
CURRENT = ["", ".", "bin", "../here"]


def plant(folder: Path, name: str, word: str) -> Path:
    program = folder / name
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text(f"#!/bin/sh\necho {word}\n")
    program.chmod(0o755)
    return program


@pytest.mark.nightly
@pytest.mark.parametrize("entry", CURRENT)
def test_what_lies_in_the_current_folder_is_not_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: str
) -> None:
    here = tmp_path / "here"
    plant(here / entry, "timedatectl", "planted")
    right = plant(tmp_path / "system", "timedatectl", "right")
    monkeypatch.chdir(here)
    monkeypatch.setenv("PATH", entry)
    assert full_path("timedatectl") is None
    assert output_of("timedatectl") is None
    monkeypatch.setenv("PATH", os.pathsep.join([entry, str(right.parent)]))
    assert full_path("timedatectl") == str(right)
    assert output_of("timedatectl") == "right\n"


def test_what_is_no_program_is_not_taken_for_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "first" / "folder").mkdir(parents=True)
    (tmp_path / "first" / "text").write_text("")
    for name in ("folder", "text"):
        plant(tmp_path / "second", name, "right")
    places = [str(tmp_path / each) for each in ("none", "first", "second")]
    monkeypatch.setenv("PATH", os.pathsep.join(places))
    assert full_path("folder") == str(tmp_path / "second" / "folder")
    assert full_path("text") == str(tmp_path / "second" / "text")


def test_a_folder_that_the_user_may_not_look_into_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(tmp_path / "forbidden", "cat", "planted")
    right = plant(tmp_path / "second", "cat", "right")
    monkeypatch.setenv("PATH", os.pathsep.join(map(str, (tmp_path / "forbidden", right.parent))))
    stat = os.stat

    def refused(path: str | Path, **options: Any) -> os.stat_result:
        if "forbidden" in str(path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return stat(path, **options)

    # Root may look into every folder.
    monkeypatch.setattr(os, "stat", refused)
    assert full_path("cat") == str(right)


# Only a text that has one of these is worth parsing.
STARTING = re.compile(r"which|os\.system|os\.popen|subprocess|[\"']-m[\"']")


def sources() -> Iterator[tuple[Path, ast.AST]]:
    for folder in PRODUCT:
        for path in sorted((ROOT / folder).rglob("*.py")):
            text = path.read_text("utf-8")
            if STARTING.search(text):
                for node in ast.walk(ast.parse(text)):
                    yield path.relative_to(ROOT), node


def by_name(call: ast.Call) -> bool:
    """Whether a program is looked for, or started, by its name alone."""
    name = ast.unparse(call.func)
    if name in {"shutil.which", "which", "os.system", "os.popen"}:
        return True
    command = call.args[0] if name.startswith("subprocess.") and call.args else None
    return isinstance(command, ast.List) and isinstance(command.elts[0], ast.Constant)


def in_current_folder(command: ast.List | ast.Tuple) -> bool:
    """Whether Python is started by ``-m`` alone, which imports a ``json.py`` of that folder."""
    words = [ast.unparse(each) for each in command.elts]
    return "'-m'" in words and "'-P'" not in words


def test_nothing_of_the_product_is_started_by_its_name_or_from_the_current_folder() -> None:
    found: list[str] = []
    for path, node in sources():
        if isinstance(node, ast.Call) and by_name(node):
            found.append(f"{path}:{node.lineno}: ask biosensor_common.child")
        if isinstance(node, ast.List | ast.Tuple) and in_current_folder(node):
            found.append(f"{path}:{node.lineno}: start Python with -P -m")
    assert not found


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


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="glibc's arenas")
def test_threads_share_as_many_arenas_as_are_allowed() -> None:
    # By default up to eight for each processor.
    assert run("as they like") == ([], 1 + THREADS)
    assert run("limited") == (["True"], ARENAS)


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="glibc's arenas")
@pytest.mark.parametrize(
    ("name", "value"),
    [("MALLOC_ARENA_MAX", "5"), ("GLIBC_TUNABLES", "glibc.malloc.arena_max=5")],
)
def test_what_the_user_has_said_holds(name: str, value: str) -> None:
    assert run("limited", **{name: value}) == (["False"], 5)


if sys.platform != "win32":
    import resource


@pytest.mark.parametrize(
    ("soft", "hard", "wanted"),
    [
        (1024, 1_048_576, [MOST, 10240]),
        (1024, 4096, [4096]),
        (1024, 1024, []),
        # macOS: no hard limit, but more than OPEN_MAX may be refused.
        (256, -1, [MOST, 10240]),
        # Somebody wants more already.
        (200_000, 1_048_576, []),
        (-1, -1, []),
        (12_000, 20_000, [20_000]),
    ],
)
def test_the_limit_is_raised_as_far_as_the_system_allows_and_streams_need(
    soft: int, hard: int, wanted: list[int]
) -> None:
    assert wanted_limits(soft, hard) == wanted


def test_streams_fit_beside_what_the_program_itself_opens() -> None:
    assert fitting(RESERVE + 3 * OUTLET - 1, OUTLET) == 2
    assert fitting(RESERVE + 3 * INLET, INLET) == 3
    assert fitting(0, OUTLET) == 0


def test_what_does_not_fit_is_an_error_with_the_command_that_makes_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(process_limits, "limit", lambda: 200)
    monkeypatch.setattr(process_limits, "opened", lambda: 200 - RESERVE // 2 - OUTLET)
    process_limits.require(OUTLET, "the stream Polar-ECG")
    monkeypatch.setattr(process_limits, "opened", lambda: 200 - RESERVE // 2 - OUTLET + 1)
    with pytest.raises(
        TransportError, match=r"Polar-ECG is left out.* 200 files.*run in"
    ) as caught:
        process_limits.require(OUTLET, "the stream Polar-ECG")
    assert caught.value.reason is TransportReason.EXHAUSTED


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
def test_a_program_may_open_as_many_files_as_the_system_allows() -> None:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (100, before[1]))
        process_limits.raise_limit()
        assert process_limits.limit() == wanted_limits(100, before[1])[0]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows does not limit open files so")
@pytest.mark.parametrize(
    ("number", "is_full"), [(errno.EMFILE, True), (errno.ENFILE, True), (errno.ENOENT, False)]
)
def test_a_system_that_does_not_list_open_files_refuses_no_stream(
    monkeypatch: pytest.MonkeyPatch, number: int, is_full: bool
) -> None:
    def refused(_: Path) -> NoReturn:
        raise OSError(number, "refused")

    monkeypatch.setattr(Path, "iterdir", refused)
    assert process_limits.has_room(OUTLET) is not is_full


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.EACCES, "choose another place"),
        (errno.EROFS, "another disk"),
        (errno.ENOSPC, "free some space"),
        (errno.ENAMETOOLONG, "a shorter name"),
        (errno.ENOENT, "make its folder first"),
    ],
)
def test_it_says_what_where_and_what_to_do(number: int, advice: str) -> None:
    path = Path("study") / "P01.csv"
    what, _, todo = cannot_write(path, OSError(number, os.strerror(number))).partition("; ")
    assert what == f"cannot write {path}: {os.strerror(number)}"
    assert advice in todo


def test_a_file_that_windows_has_open_elsewhere_is_to_be_closed() -> None:
    error = PermissionError(errno.EACCES, "The process cannot access the file")
    error.winerror = 32  # pyright: ignore[reportAttributeAccessIssue] - only Windows declares it
    assert cannot_write("table.csv", error).endswith("close the program that has it open")


def test_without_a_known_remedy_it_says_what_the_system_says() -> None:
    assert cannot_write("x.csv", OSError("no luck")) == "cannot write x.csv: no luck"


def test_a_real_folder_that_is_missing() -> None:
    missing = Path("no such folder") / "x.csv"
    with pytest.raises(OSError, match="No such file") as caught:
        missing.write_text("")
    assert "make its folder first" in cannot_write(missing, caught.value)


HEAVY = {"numpy", "pylsl", "rclpy"}
IMPORT_EVERYTHING = """
import sys
sys.path.insert(0, sys.argv[1])
from importlib import import_module
from pkgutil import walk_packages
import biosensor_common
for module in walk_packages(biosensor_common.__path__, "biosensor_common."):
    # Of a program of its own, which asks LSL; of pylsl's kind; bytes of messages from arrays.
    if module.name.partition(".")[2] not in (
        "doctor.lsl_process", "lsl.inlet", "lsl.network", "lsl.outlet",
        "ros.cdr", "ros.messages", "ros.standard_messages",
    ):
        import_module(module.name)
print(*sys.modules)
"""


@pytest.mark.seam
def test_every_module_needs_the_standard_library_only() -> None:
    # Without site (-S) nothing that was installed can be imported at all.
    root = Path(biosensor_common.__path__[0]).parent
    result = subprocess.run(
        [sys.executable, "-I", "-S", "-c", IMPORT_EVERYTHING, str(root)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    loaded = set(result.stdout.split())
    assert {"biosensor_common.naming", "biosensor_common.table"} <= loaded
    assert not HEAVY & loaded


@pytest.mark.nightly
def test_no_module_takes_what_happens_to_be_installed() -> None:
    script = IMPORT_EVERYTHING.replace("sys.path.insert(0, sys.argv[1])", "")
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert not HEAVY & set(result.stdout.split())


# Lines to an output that is held: nobody waits, nothing is mixed up, what is missing is said.


DEADLINE_S = 30.0


class Held:
    """An output that takes nothing until it is released."""

    def __init__(self) -> None:
        self.lines: list[bytes] = []
        self.ended = 0
        self.is_released, self.is_asked = threading.Event(), threading.Event()

    def write(self, lines: bytes) -> None:
        self.is_asked.set()
        assert self.is_released.wait(DEADLINE_S)
        self.lines.append(lines)

    def end(self) -> None:
        self.ended += 1

    def writer(self, most_bytes: int) -> NonblockingWriter:
        """Return one whose thread stands in the write of a first line."""
        writer = NonblockingWriter("disk", self.write, end=self.end, most_bytes=most_bytes)
        writer.put(b"first\n")
        assert self.is_asked.wait(DEADLINE_S)
        return writer


@pytest.fixture
def held() -> Held:
    return Held()


@pytest.mark.nightly
def test_what_does_not_fit_is_counted_in_its_place(held: Held) -> None:
    writer = held.writer(most_bytes=12)
    # Once it was full it takes nothing, however short, until half of it is gone.
    for line in (b"1\n", b"2345\n", b"two\nlines too many\n", b"3\n"):
        writer.put(line)
    held.is_released.set()
    assert writer.flush(DEADLINE_S)
    writer.put(b"4\n")
    assert writer.close(DEADLINE_S)
    said = b"[3 lines are missing here: the disk accepted no output]\n"
    assert held.lines == [b"first\n", b"1\n", b"2345\n", said, b"4\n"]
    assert held.ended == 1


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="fills a pipe")
def test_a_program_whose_output_is_held_ends_all_the_same() -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(512))
    os.set_blocking(writing, True)
    hangs = (
        "import threading; from biosensor_common.process_limits import end_within;"
        "end_within(0.5, 7); threading.Event().wait()"
    )
    program = subprocess.Popen([sys.executable, "-c", hangs], stderr=writing)
    try:
        assert program.wait(DEADLINE_S) == 7
    finally:
        program.kill()
        os.close(reading)
        os.close(writing)


@pytest.mark.nightly
def test_what_is_missing_at_the_end_is_said_as_well(held: Held) -> None:
    writer = held.writer(most_bytes=2)
    writer.put(b"1\n")
    writer.put(b"2\n")
    held.is_released.set()
    assert writer.close(DEADLINE_S)
    said = b"[1 line is missing here: the disk accepted no output]\n"
    assert held.lines == [b"first\n", b"1\n", said]


@pytest.mark.nightly
def test_a_line_that_is_longer_than_the_queue_goes_through_alone(held: Held) -> None:
    writer = held.writer(most_bytes=2)
    writer.put(b"much too long\n")
    held.is_released.set()
    assert writer.close(DEADLINE_S)
    assert held.lines == [b"first\n", b"much too long\n"]


@pytest.mark.nightly
def test_a_held_output_ends_nobody_s_patience_twice(held: Held) -> None:
    writer = held.writer(most_bytes=100)
    assert writer.held_for_s > 0
    assert not writer.flush(0.01)
    assert not writer.close(0.01)
    # It would wait for ever if it counted.
    assert not writer.close(threading.TIMEOUT_MAX)
    assert held.ended == 0
    held.is_released.set()


@pytest.mark.seam
def test_lines_of_many_threads_stay_whole_and_each_in_its_order() -> None:
    lines: list[bytes] = []
    writer = NonblockingWriter("disk", lines.append)

    def put(name: int) -> None:
        for number in range(500):
            writer.put(b"%d %d\n" % (name, number))

    threads = [threading.Thread(target=put, args=[name]) for name in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert writer.close(DEADLINE_S)
    assert writer.held_for_s == 0.0
    for name in range(4):
        own = [line for line in lines if line.startswith(b"%d " % name)]
        assert own == [b"%d %d\n" % (name, number) for number in range(500)]


@pytest.mark.nightly
@pytest.mark.parametrize("refusal", [BrokenPipeError(), ValueError("write to closed file")])
def test_an_output_that_refuses_is_tried_again_with_the_next_line(refusal: Exception) -> None:
    lines: list[bytes] = []

    def write(line: bytes) -> None:
        if line == b"bad\n":
            raise refusal
        lines.append(line)

    writer = NonblockingWriter("disk", write)
    for line in (b"good\n", b"bad\n", b"better\n"):
        writer.put(line)
    assert writer.close(DEADLINE_S)
    assert lines == [b"good\n", b"better\n"]


@pytest.mark.seam
@pytest.mark.parametrize("at_once", [False, True])
def test_what_liblsl_writes_of_each_outlet_without_a_network_is_one_sentence(
    at_once: bool,
) -> None:
    """As liblsl 1.18 wrote it, three lines for each outlet, in a namespace with `lo` alone."""
    warning = (
        b"18:27:40.871 (   2.714s) [        823EF540] stream_outlet_impl.cpp:103   WARN| "
        b"Couldn't create multicast responder for 224.0.0.1 (Could not join any multicast group)\n"
    )
    # Without IPv6 alone others find the streams, and nothing is said of multicast as a whole.
    of_ipv6 = warning.replace(b"224.0.0.1", b"ff02:113d::1")
    heard: list[bytes] = []
    writer = NonblockingWriter("console", heard.append)
    descriptor = os.open(os.devnull, os.O_WRONLY)
    relay = Relay(descriptor, writer)
    parts = [
        of_ipv6,
        3 * warning,
        b"Stream transmission broke off\n",
        b"a line\n" + 2 * warning,
    ]
    for lines in [b"".join(parts)] if at_once else parts:
        os.write(descriptor, lines)
    relay.close(DEADLINE_S)
    os.close(descriptor)
    assert writer.close(DEADLINE_S)
    assert b"".join(heard) == of_ipv6 + NO_NETWORK + b"Stream transmission broke off\na line\n"
