"""The worked example: its programs and commands, as they stand on its page, in their order."""

from __future__ import annotations

import csv
import itertools
import json
import math
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from std_msgs.msg import Float32

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "example.md"
PANDAS = ROOT / ".venv-peers" / "bin" / "python"
COMMAND_LIMIT_S = 90
_BLOCK = re.compile(r'^```(\w+) title="([^"]+)"\n(.*?)^```$', re.MULTILINE | re.DOTALL)
# They run until they are told to end; all others end by themselves.
_STAYS = re.compile(r"biosensor-gateway run|robot\.py|lsl_to_ros")

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(400)]


class Line(NamedTuple):
    terminal: str
    command: str


def _lines() -> list[Line]:
    blocks = _BLOCK.findall(PAGE.read_text(encoding="utf-8"))
    return [
        Line(title, command)
        for language, title, text in blocks
        if language == "sh"
        for command in text.splitlines()
    ]


def _save_programs(folder: Path) -> None:
    for language, title, text in _BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        if language == "python":
            (folder / title).write_text(text, encoding="utf-8")


def _arguments(command: str) -> list[str]:
    words = shlex.split(command)
    if words[0] == "biosensor-gateway":
        return [sys.executable, "-m", "biosensor_gateway.cli", *words[1:]]
    if words[0] == "python3":
        program = str(PANDAS) if words[1] == "table.py" else sys.executable
        return [program, *words[1:]]
    return words


class Terminals:
    """The page's terminals; a program that stays is ended by the next one in its terminal."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._staying: dict[str, subprocess.Popen[bytes]] = {}

    def type(self, line: Line) -> str:
        """Return what it prints, if it ends by itself."""
        if not _STAYS.search(line.command):
            done = subprocess.run(
                _arguments(line.command),
                cwd=self.folder,
                capture_output=True,
                timeout=COMMAND_LIMIT_S,
                text=True,
                check=False,
            )
            assert done.returncode == 0, (line.command, done.stdout, done.stderr)
            return done.stdout
        self.end(line.terminal)
        with (self.folder / f"{line.terminal}.log").open("wb") as log:
            self._staying[line.terminal] = subprocess.Popen(
                _arguments(line.command),
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        return ""

    def end(self, terminal: str) -> None:
        process = self._staying.pop(terminal, None)
        if process is None:
            return
        process.send_signal(signal.SIGINT)
        try:
            process.wait(30)
        finally:
            process.kill()
            process.wait()

    def end_all(self) -> None:
        for terminal in list(self._staying):
            self.end(terminal)


@pytest.fixture
def terminals(tmp_path: Path) -> Generator[Terminals]:
    opened = Terminals(tmp_path)
    yield opened
    opened.end_all()


def _are_there(*names: str) -> bool:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "status", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    devices: list[dict[str, Any]] = []
    if done.returncode == 0:
        devices = json.loads(done.stdout)["devices"]
    streaming = {each["participant"] for each in devices if each["state"] == "streaming"}
    return streaming >= set(names) and all(each["state"] == "streaming" for each in devices)


def test_the_page_is_true(
    terminals: Terminals,
    listener: Any,
    wait_until: Callable[..., None],
) -> None:
    folder, lines = terminals.folder, _lines()
    _save_programs(folder)
    played = listener.listen(Float32, "/P01/biosensors/polar_h10/ecg")
    before, last = lines[:-2], lines[-2:]
    for terminal, group in itertools.groupby(before, key=lambda line: line.terminal):
        for line in group:
            terminals.type(line)
        if terminal == "terminal 1":
            wait_until(lambda: _are_there("P01", "P02"), "two people stream")
        elif terminal == "terminal 3":
            # Somebody who types the next command is not faster.
            time.sleep(3.0)
    _check_table(folder / "beats.csv")
    assert {"study_bids", "study_bag"} <= {path.name for path in folder.iterdir()}
    # The real strap is not heard here: no node ran.
    assert not played
    for line in last:
        terminals.type(line)
    with (folder / "study_csv" / "P01-polar_h10-virtual-ecg.csv").open() as file:
        recorded = [float(np.float32(row[1])) for row in list(csv.reader(file))[1:]]

    def heard() -> list[float]:
        return [message.data for message in list(played)]

    # The first may be gone before this subscriber has found the new topic.
    wait_until(
        lambda: len(played) > 0.8 * len(recorded) and heard()[-1] == recorded[-1],
        "the recording is published",
    )
    assert heard() == recorded[-len(heard()) :]


def _check_table(path: Path) -> None:
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert {row["person"] for row in rows} == {"P01", "P02"}
    assert len(rows) > 20
    times = [float(row["lsl_time"]) for row in rows]
    assert times == sorted(times)
    for row in rows:
        shoulder, elbow = float(row["shoulder.position"]), float(row["elbow.position"])
        assert math.isclose(shoulder**2 + elbow**2, 1.0, rel_tol=1e-9)
        assert 0.3 < float(row["RR"]) < 2.0
    since = [float(row["since_handover_s"]) for row in rows if row["since_handover_s"]]
    assert since
    # The robot hands something over every two seconds.
    assert max(since) < 4.0
