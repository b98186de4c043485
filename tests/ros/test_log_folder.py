"""What is to be said is said, but never floods the log, wherever it is."""

from __future__ import annotations

import os
import re
import threading
from pathlib import Path
from typing import TYPE_CHECKING, cast

import pytest
from rclpy.logging import RcutilsLogger

from lsl_to_ros import limited_log
from lsl_to_ros.limited_log import BURST, BURST_S, SAME_AGAIN_S, LimitedLog
from lsl_to_ros.ros_environment import ensure_log_folder, usual_folder
from tests.rigs.virtual_time import SetClock

if TYPE_CHECKING:
    from tests.ros.conftest import Ros

# ROS's log files go elsewhere where their folder cannot be written.


def test_the_folder_is_that_of_rcl(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert usual_folder({}) == tmp_path / ".ros/log"
    assert usual_folder({"ROS_HOME": "/opt/r"}) == Path("/opt/r/log")
    assert usual_folder({"ROS_HOME": "/opt/r", "ROS_LOG_DIR": "~/logs"}) == tmp_path / "logs"


def test_a_folder_that_can_be_written_is_used(tmp_path: Path) -> None:
    environment = {"ROS_HOME": str(tmp_path / "ros")}
    assert ensure_log_folder(environment) == ""
    assert environment.keys() == {"ROS_HOME"}


def test_another_one_takes_the_place_of_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    # Below a file there is no folder, not even for root.
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    environment = {"ROS_HOME": str(in_the_way)}
    said = ensure_log_folder(environment)
    instead = Path(environment["ROS_LOG_DIR"])
    assert said.startswith(
        f"{in_the_way / 'log'} cannot be written; ROS's log files are in {instead}"
    )
    assert os.access(instead, os.W_OK)
    instead.rmdir()


# What is to be said is said, but never floods the log, nor is held back without a word.
class Recorder:
    """What a logger is asked to write."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.levels: list[str] = []

    def warning(self, message: str) -> bool:
        return self._take("warning", message)

    def info(self, message: str) -> bool:
        return self._take("info", message)

    def _take(self, level: str, message: str) -> bool:
        self.said.append(message)
        self.levels.append(level)
        return True

    @property
    def held_back(self) -> int:
        """How many lines are said to have been held back."""
        found = (re.search(r"\((\d+) lines were held back\)$", said) for said in self.said)
        return sum(int(match[1]) for match in found if match)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SetClock:
    clock = SetClock()
    monkeypatch.setattr(limited_log, "monotonic", clock)
    return clock


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def log(clock: SetClock, recorder: Recorder) -> LimitedLog:
    assert clock.now_s
    return LimitedLog(cast("RcutilsLogger", recorder))


def test_different_sentences_are_all_said(log: LimitedLog, recorder: Recorder) -> None:
    for sentence in "abc":
        log.warn(sentence)
    assert recorder.said == ["a", "b", "c"]


def test_a_sentence_is_said_once_a_minute(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    log.warn("a")
    clock.now_s += SAME_AGAIN_S - 0.001
    log.warn("a")
    assert recorder.said == ["a"]
    clock.now_s += 0.001
    log.warn("a")
    log.warn("a")
    assert recorder.said == ["a", "a (1 lines were held back)"]
    clock.now_s += SAME_AGAIN_S
    log.warn("a")
    assert recorder.said[2:] == ["a (1 lines were held back)"]


def test_repeating_a_sentence_does_not_put_off_its_next_time(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    for _ in range(int(SAME_AGAIN_S) + 1):
        log.warn("a")
        clock.now_s += 1.0
    assert len(recorder.said) == 2


def test_a_burst_is_cut_off_and_counted(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    for number in range(BURST + 30):
        log.warn(f"stream {number}")
    assert recorder.said == [f"stream {number}" for number in range(BURST)]
    clock.now_s += BURST_S - 0.001
    log.warn("too early")
    assert len(recorder.said) == BURST
    clock.now_s += 0.001
    log.warn("the next")
    assert recorder.said[-1] == "the next (31 lines were held back)"
    log.warn("and one more")
    assert recorder.said[-1] == "and one more"


def test_what_a_burst_held_back_can_still_be_said(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    for number in range(BURST + 1):
        log.warn(f"stream {number}")
    clock.now_s += BURST_S
    log.warn(f"stream {BURST}")
    assert recorder.said[-1] == f"stream {BURST} (1 lines were held back)"


def test_every_warning_of_every_thread_is_said_or_counted(
    log: LimitedLog, recorder: Recorder, clock: SetClock
) -> None:
    different, repeats, count = BURST // 4, 5, 8

    def warn(who: int) -> None:
        for number in range(different * repeats):
            log.warn(f"{who}: {number % different}")

    threads = [threading.Thread(target=warn, args=(who,)) for who in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    clock.now_s += BURST_S
    log.warn("the last")
    assert len(recorder.said) == BURST + 1
    assert len(recorder.said) + recorder.held_back == count * different * repeats + 1


def test_what_is_no_warning_is_limited_too(log: LimitedLog, recorder: Recorder) -> None:
    log.inform("attached")
    log.inform("attached")
    log.warn("lost")
    assert recorder.said == ["attached", "lost (1 lines were held back)"]
    assert recorder.levels == ["info", "warning"]


@pytest.mark.nightly
def test_the_loggers_of_rclpy_write_it(ros: Ros, capfd: pytest.CaptureFixture[str]) -> None:
    log = LimitedLog(ros.node.get_logger())
    log.warn("100 % of {x} was lost")
    log.warn("100 % of {x} was lost")
    written = capfd.readouterr().err
    assert written.count("100 % of {x} was lost") == 1
    assert "WARN" in written
