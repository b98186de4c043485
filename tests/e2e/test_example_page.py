"""The worked examples: their programs and commands, as they stand on their pages."""

from __future__ import annotations

import csv
import itertools
import json
import math
import os
import re
import shlex
import signal
import statistics
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.duration import Duration
from std_msgs.msg import Float32, Float32MultiArray

from tests.rigs.polling import wait_until

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "example.md"
PANDAS = ROOT / ".venv-peers" / "bin" / "python"
COMMAND_LIMIT_S = 90
_BLOCK = re.compile(r'^```(\w+) title="([^"]+)"\n(.*?)^```$', re.MULTILINE | re.DOTALL)
# They run until they are told to end; all others end by themselves.
_STAYS = re.compile(r"biosensor-gateway run|robot\.py|lsl_to_ros")


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


@pytest.mark.nightly
@pytest.mark.timeout(400)
def test_the_page_is_true(
    terminals: Terminals,
    listener: Any,
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
        recorded = [float(np.float32(row[-1])) for row in list(csv.reader(file))[1:]]

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


ACTING_PAGE = ROOT / "docs" / "acting-on-features.md"
HEART_RATE = "/P01/biosensors/polar_h10/hr_live"
HEART_STATE = "/P01/biosensors/polar_h10/hr_state"
DEADLINE_S = 30.0
# The library of trees, and what it imports; of the other peers, nothing may be found.
TREES = ("py_trees", "pydot", "pyparsing")
_PROGRAM = re.compile(r'^```python title="([^"]+)"\n(.*?)^```$', re.MULTILINE | re.DOTALL)
_COMMAND = re.compile(r"^ros2 run lsl_to_ros lsl_to_ros (--ros-args .*)$", re.MULTILINE)

Start = Callable[[str], object]


@pytest.fixture
def start(tmp_path: Path) -> Generator[Start]:
    """Start a program of the page; it runs to the end of the test, and must."""
    running: list[subprocess.Popen[bytes]] = []
    (installed,) = ROOT.glob(".venv-peers/lib/python*/site-packages")
    for package in TREES:
        (tmp_path / package).symlink_to(installed / package)
    texts = dict(_PROGRAM.findall(ACTING_PAGE.read_text(encoding="utf-8")))

    def run(name: str) -> None:
        (tmp_path / name).write_text(texts[name], encoding="utf-8")
        running.append(subprocess.Popen([sys.executable, str(tmp_path / name)], env=os.environ))

    yield run
    codes = [process.poll() for process in running]
    for process in running:
        process.kill()
        process.wait()
    assert codes == [None] * len(running)


class Strap:
    """The topics of a heart rate, and of what is known of it."""

    def __init__(self, listener: Any) -> None:
        self._node = listener.node
        self._publisher = self._node.create_publisher(Float32, HEART_RATE, 10)
        self._states = self._node.create_publisher(Float32MultiArray, HEART_STATE, 10)

    @property
    def is_heard(self) -> bool:
        return self._publisher.get_subscription_count() > 0

    @property
    def is_state_heard(self) -> bool:
        return self._states.get_subscription_count() > 0

    def tell_state(self, rate: float, quality: float = 1.0) -> None:
        """Tell a rate of now, that of somebody at rest, with this quality."""
        self._states.publish(Float32MultiArray(data=array("f", [rate, 0.5, quality, 0.0, 11.0])))

    def meet(self) -> None:
        """Return once a subscriber hears it: one that is seen may not see the publisher yet."""
        self.tell(math.nan)
        assert self._publisher.wait_for_all_acked(Duration(seconds=DEADLINE_S))

    def tell(self, rate: float) -> None:
        self._publisher.publish(Float32(data=rate))

    def tell_each(self, rates: Sequence[float], name: str) -> None:
        """Tell them to a node that must take every one: its queue has ten places.

        What is published comes before a request that is sent after it, and of what has come an
        executor takes messages before requests. So an answer says that the rate was taken.
        """
        services = self._node.create_client(SetParameters, f"/{name}/set_parameters")
        assert services.wait_for_service(timeout_sec=DEADLINE_S)
        for rate in rates:
            self.tell(rate)
            answer, deadline = services.call_async(SetParameters.Request()), _deadline()
            while not answer.done():
                assert time.monotonic() < deadline, f"{name} has not answered"
                time.sleep(0.001)
        self._node.destroy_client(services)


def _deadline() -> float:
    return time.monotonic() + DEADLINE_S


@pytest.fixture
def strap(listener: Any) -> Strap:
    return Strap(listener)


@pytest.mark.nightly
def test_a_score_is_how_far_a_person_is_from_their_rest(
    start: Start, strap: Strap, listener: Any
) -> None:
    scores: list[Float32] = listener.listen(Float32, "/P01/hr_above_rest")
    start("score.py")
    wait_until(lambda: strap.is_heard, "the score's subscription")
    rest = [65.0, 75.0] * 30
    strap.meet()
    strap.tell_each([*rest[:10], math.nan, *rest[10:], math.nan], "score")
    assert scores == []

    def is_told() -> bool:
        strap.tell(80.0)
        return bool(scores)

    wait_until(is_told, "a score")
    spread = statistics.stdev(rest)
    assert scores[0].data == pytest.approx((80.0 - 70.0) / spread)


@pytest.mark.nightly
def test_the_tree_is_fast_only_while_the_person_is_known_to_be_calm(
    start: Start, strap: Strap, listener: Any
) -> None:
    speeds: list[Float32] = listener.listen(Float32, "/speed_scale")

    def comes(speed: float, what: str) -> None:
        wait_until(lambda: speeds and speeds[-1].data == pytest.approx(speed), what)

    start("tree.py")
    wait_until(lambda: strap.is_state_heard, "the condition's subscription")
    comes(0.3, "slow without a heart rate")

    def is_fast() -> bool:
        # A subscriber that is seen may not see the publisher yet.
        strap.tell_state(70.0)
        return speeds[-1].data == pytest.approx(1.0)

    wait_until(is_fast, "fast with a calm one")
    for rate, quality in ((130.0, 1.0), (60.0, 0.4), (60.0, math.nan), (math.nan, 1.0)):
        strap.tell_state(rate, quality)
        comes(0.3, f"slow with {rate} of quality {quality}")
        strap.tell_state(70.0)
        comes(1.0, "fast again")
    comes(0.3, "slow when the newest one is of long ago")


@pytest.mark.nightly
def test_a_namespace_puts_a_person_where_ros4hri_looks(programs: Any, listener: Any) -> None:
    (arguments,) = _COMMAND.findall(ACTING_PAGE.read_text(encoding="utf-8"))
    programs.start("lsl_to_ros.node", *arguments.split())
    programs.start("biosensor_gateway.cli", "run", "--simulate", "polar_h10@P01", "--features")
    topic = "/humans/persons/P01/biosensors/polar_h10/hr_live"
    assert topic in ACTING_PAGE.read_text(encoding="utf-8")
    rates = listener.listen(Float32, topic)
    wait_until(lambda: rates, "a heart rate below /humans/persons")
    assert 40 < rates[0].data < 150
