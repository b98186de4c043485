"""Whatever asks a process to end: it closes everything, once, and exits with 0."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path

import pytest

from biosensor_gateway.system.shutdown import until_signalled
from tests.rigs.polling import wait_until

DEADLINE_S = 30.0
PROGRAM = Path(__file__).with_name("shutdown_program.py")
WHOLE_STORY = ["running", "closing", "closed", "returned", "exiting"]
REQUESTS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]

ANY_REQUEST = pytest.mark.parametrize("number", REQUESTS)
Process = subprocess.Popen[bytes]


class Started:
    """Starts the program and knows what it has recorded and said."""

    def __init__(self, folder: Path) -> None:
        self._record, self._said = folder / "record.txt", folder / "said.txt"
        self._until = wait_until
        self.processes: list[Process] = []

    def __call__(
        self,
        closing_s: float = 0.0,
        word: str = "",
        *,
        first: str = "running",
        under: tuple[str, ...] = (),
        terminal: int = subprocess.DEVNULL,
    ) -> Process:
        command = [*under, sys.executable, str(PROGRAM), str(self._record), str(closing_s), word]
        with self._said.open("wb") as said:
            process = subprocess.Popen(command, stdin=terminal, stdout=said, stderr=said)
        self.processes.append(process)
        self.wait_for(first)
        return process

    def wait_for(self, line: str) -> None:
        self._until(lambda: line in self.story)

    def record(self, line: str) -> None:
        with self._record.open("a") as file:
            file.write(f"{line}\n")

    @property
    def story(self) -> list[str]:
        return self._record.read_text().splitlines() if self._record.exists() else []

    @property
    def said(self) -> str:
        return self._said.read_text()


@pytest.fixture
def start(tmp_path: Path) -> Generator[Started]:
    started = Started(tmp_path)
    yield started
    for process in started.processes:
        process.kill()
        process.wait()


@pytest.mark.seam
@ANY_REQUEST
def test_a_request_closes_everything(start: Started, number: signal.Signals) -> None:
    process = start()
    process.send_signal(number)
    assert process.wait(DEADLINE_S) == 0
    assert start.story == WHOLE_STORY
    assert start.said == ""


@pytest.mark.nightly
@ANY_REQUEST
def test_further_requests_cut_nothing_short(start: Started, number: signal.Signals) -> None:
    process = start(closing_s=1.0)
    process.send_signal(number)
    start.wait_for("closing")
    for again in (*REQUESTS, *REQUESTS):
        process.send_signal(again)
        time.sleep(0.05)
    assert process.wait(DEADLINE_S) == 0
    assert start.story == WHOLE_STORY
    assert start.said == ""


@pytest.mark.nightly
@ANY_REQUEST
def test_nothing_is_cut_short_after_the_loop_has_closed(
    start: Started, number: signal.Signals
) -> None:
    process = start(word="late")
    process.send_signal(signal.SIGINT)
    start.wait_for("returned")
    process.send_signal(number)
    start.record("go on")
    assert process.wait(DEADLINE_S) == 0
    assert start.story == [*WHOLE_STORY[:-1], "go on", "gone on", "exiting"]
    assert start.said == ""


@pytest.mark.nightly
@ANY_REQUEST
@pytest.mark.parametrize(
    ("word", "story"),
    [("early", ["starting"]), ("behind", ["running", "behind", *WHOLE_STORY[1:]])],
)
def test_a_request_before_it_runs_or_while_the_loop_is_behind_is_not_lost(
    start: Started, number: signal.Signals, word: str, story: list[str]
) -> None:
    process = start(word=word, first="starting" if word == "early" else word)
    process.send_signal(number)
    assert process.wait(DEADLINE_S) == 0
    assert start.story == story
    assert start.said == ""


@pytest.mark.seam
@pytest.mark.parametrize(
    ("word", "story"), [("hang", ["running", "closing"]), ("block", ["running"])]
)
def test_a_thread_or_loop_that_hangs_holds_up_no_end(
    start: Started, word: str, story: list[str]
) -> None:
    process = start(word=word)
    process.send_signal(signal.SIGTERM)
    assert process.wait(DEADLINE_S) == 1
    assert start.story == story
    assert start.said == "it has not ended within 0.2 s, so it is being ended now\n"


@pytest.mark.nightly
def test_a_terminal_that_is_closed_is_a_request(start: Started) -> None:
    ours, terminal = os.openpty()
    process = start(under=("setsid", "--ctty"), terminal=terminal)
    os.close(terminal)
    os.close(ours)
    assert process.wait(DEADLINE_S) == 0
    assert start.story == WHOLE_STORY
    assert start.said == ""


@pytest.mark.seam
def test_under_nohup_it_outlives_its_terminal(start: Started) -> None:
    process = start(under=("nohup",))
    process.send_signal(signal.SIGHUP)
    time.sleep(0.5)
    assert start.story == ["running"]
    process.send_signal(signal.SIGTERM)
    assert process.wait(DEADLINE_S) == 0
    assert start.story == WHOLE_STORY


def test_what_ends_by_itself_leaves_the_signals_as_they_were() -> None:
    before = [signal.getsignal(number) for number in REQUESTS]

    async def short() -> None:
        await asyncio.sleep(0)

    asyncio.run(until_signalled(short))
    assert [signal.getsignal(number) for number in REQUESTS] == before


def test_a_failure_is_passed_on() -> None:
    async def failing() -> None:
        raise LookupError("the reason")

    with pytest.raises(LookupError, match="the reason"):
        asyncio.run(until_signalled(failing))
