"""Runs the commands of a part, and says on which version of the project."""

from __future__ import annotations

import hashlib
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from tests.nightly.parts import ROOT, Part
from tests.nightly.result import Failure, Result, last_lines

# Runs the commands of a part.

HANGS_AFTER_S = 3600.0
"""Nothing else is decided by time: the report names a part that takes over half an hour."""
_ENDS_WITHIN_S = 60.0
_NOT_ENDED = 124
_NO_TESTS = 5


def run_part(part: Part, folder: Path, seed: int, root: Path = ROOT) -> Result:
    """Run all of a part; its log and the results of its tests are files in the folder."""
    result = Result(part.name, datetime.now(UTC).isoformat(timespec="seconds"))
    result.missing = part.missing()
    if result.missing:
        return result
    folder.mkdir(parents=True, exist_ok=True)
    log, junit = folder / f"{part.name}.log", folder / f"{part.name}.junit.xml"
    for file in (log, junit):
        file.unlink(missing_ok=True)
    begin_s = time.monotonic()
    if all(_add(result, _words(line, seed), log, root) for line in part.before):
        if part.tests:
            _run_tests(result, part, log, junit, root)
        for line in part.commands:
            _add(result, _words(line, seed), log, root)
    result.seconds = round(time.monotonic() - begin_s, 1)
    return result


def _run_tests(result: Result, part: Part, log: Path, junit: Path, root: Path) -> None:
    code, said = run_command(part.test_command(junit), log, root)
    if junit.exists():
        result.add_tests(junit)
    if code == _NO_TESTS:
        # A mark or a folder may have got another name.
        result.failures.append(Failure("pytest", ["No test belongs to this part."]))
    elif code and not result.failures:
        result.failures.append(Failure("pytest", last_lines(said)))


def _add(result: Result, command: Sequence[str], log: Path, root: Path) -> bool:
    code, said = run_command(command, log, root)
    if code:
        result.failures.append(Failure(shlex.join(command), last_lines(said)))
    return code == 0


def _words(line: str, seed: int) -> list[str]:
    program, *arguments = shlex.split(line.format(seed=seed))
    return [sys.executable if program == "python" else program, *arguments]


def run_command(command: Sequence[str], log: Path, root: Path) -> tuple[int, str]:
    """Run a command, append to the log; return its exit code and what it said.

    It has a session of its own, so that what interrupts this program reaches it once, from here.
    """
    with log.open("a+", encoding="utf-8", errors="replace") as said:
        begin = said.seek(0, os.SEEK_END)
        with subprocess.Popen(
            command,
            cwd=root,
            env=_environment(root),
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        ) as process:
            try:
                code = process.wait(HANGS_AFTER_S)
            except subprocess.TimeoutExpired:
                _end(process)
                said.write(f"\n{shlex.join(command)} did not end within {HANGS_AFTER_S:.0f} s.\n")
                said.flush()
                code = _NOT_ENDED
            except KeyboardInterrupt:
                _end(process)
                raise
        said.seek(begin)
        return code, said.read()


def _end(process: subprocess.Popen[bytes]) -> None:
    """Let the tests end what they have started, then end what is left."""
    os.killpg(process.pid, signal.SIGINT)
    try:
        process.wait(_ENDS_WITHIN_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)


def _environment(root: Path) -> dict[str, str]:
    # As the Makefile has it: tests start thousands of programs, which would all be compiled again.
    environment = {"PYTHONPYCACHEPREFIX": str(root / "build" / "bytecode"), **os.environ}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    # Wheels of ROS set these as Python starts. A part with an environment of its own would load
    # the libraries of this one, or none.
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
    paths = environment.pop("LD_LIBRARY_PATH", "").split(os.pathsep)
    others = [each for each in paths if each and not Path(each).is_relative_to(sys.prefix)]
    return environment | ({"LD_LIBRARY_PATH": os.pathsep.join(others)} if others else {})


# On which version of the project tests run.
@dataclass(frozen=True)
class Version:
    """A commit, and which files differ from it."""

    commit: str
    title: str
    changed: tuple[str, ...]
    key: str
    """Names the folder of the results: changed files are another version."""

    @property
    def seed(self) -> int:
        """A number that is another one for each commit."""
        return int(self.commit[:7], 16)


def version(root: Path = ROOT) -> Version:
    """Ask git; raises ``CalledProcessError`` where there is no commit."""
    commit, title = _git(root, "log", "-1", "--format=%H%n%s").splitlines()
    changed = _git(root, "status", "--porcelain")
    key = commit[:12]
    if changed:
        difference = hashlib.sha256((changed + _git(root, "diff", "HEAD")).encode())
        for file in _git(root, "ls-files", "--others", "--exclude-standard").splitlines():
            if (root / file).is_file():
                difference.update((root / file).read_bytes())
        key += f"-changed-{difference.hexdigest()[:8]}"
    return Version(commit, title, tuple(changed.splitlines()), key)


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "-c", "core.quotePath=false", *arguments]
    asked = subprocess.run(
        command, cwd=root, check=True, stdout=subprocess.PIPE, encoding="utf-8", errors="replace"
    )
    return asked.stdout
