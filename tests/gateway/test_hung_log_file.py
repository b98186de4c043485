"""A log file on a disk that hangs: a FIFO that nobody reads takes as little."""

from __future__ import annotations

import json
import math
import os
import re
import select
import subprocess
import sys
import threading
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import pytest
import structlog

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.system import logs
from biosensor_gateway.system.logs import LOG_FILE_NAME, configure_logs

pytestmark = pytest.mark.nightly

DEADLINE_S = 30.0
LINES, PADDING = 4000, "x" * 400
HELD = "the log file takes no output"
LOG = structlog.stdlib.get_logger("biosensor_gateway.test")

# What it logs must come to the console while the file is held, and then it has to end.
PROGRAM = """
import sys, time
from pathlib import Path
import structlog
from biosensor_gateway.system.logs import HELD_AFTER_S
from biosensor_gateway.system.logs import configure_logs
from biosensor_gateway.settings.models import LogSettings

configure_logs(LogSettings(), Path(sys.argv[1]))
log = structlog.stdlib.get_logger("biosensor_gateway.test")
for number in range(400):
    log.info("filling", number=number, padding="x" * 400)
time.sleep(HELD_AFTER_S + 0.5)
for number in range(3):
    log.info("meanwhile", number=number)
"""


@pytest.fixture
def fifo(tmp_path: Path) -> Path:
    path = tmp_path / LOG_FILE_NAME
    os.mkfifo(path)
    return path


@pytest.fixture
def unread(fifo: Path) -> Generator[int]:
    """The FIFO, open for reading."""
    descriptor = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    yield descriptor
    os.close(descriptor)


def test_the_console_goes_on_and_says_so_and_the_process_ends(fifo: Path, unread: int) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(fifo.parent)],
        stderr=subprocess.PIPE,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert ended.returncode == 0
    lines = ended.stderr.splitlines()
    assert sum("meanwhile" in line for line in lines) == 3
    assert sum("filling" in line for line in lines) == 400
    assert ended.stderr.count(HELD) == 1
    assert len(lines) == 404
    assert select.select([unread], [], [], 0)[0]


def test_what_did_not_fit_is_counted_in_its_place(
    fifo: Path,
    unread: int,
    until: Callable[[Callable[[], bool]], None],
    logging_as_before: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    del logging_as_before
    # On a starved machine its own line about the held file would be among those that are missing.
    monkeypatch.setattr(logs, "HELD_AFTER_S", math.inf)
    configure_logs(LogSettings(), fifo.parent)
    for number in range(LINES):
        LOG.info("filling", number=number, padding=PADDING)
    read = bytearray()

    def has_all() -> bool:
        if select.select([unread], [], [], 0)[0]:
            read.extend(os.read(unread, 1 << 16))
        return b"missing" in read and read.endswith(b"\n")

    until(has_all)
    LOG.info("again")
    until(lambda: has_all() and b"again" in read)
    records: list[dict[str, Any]] = [json.loads(line) for line in read.splitlines()]
    came = [record["number"] for record in records if record["event"] == "filling"]
    assert came == list(range(len(came)))
    notice, again = [record for record in records if record["event"] != "filling"]
    missing = re.fullmatch(
        r"(\d+) lines are missing here: the log file took no output", notice["event"]
    )
    assert missing is not None
    assert int(missing[1]) == LINES - len(came) > 0
    assert (notice["level"], again["event"]) == ("warning", "again")


def test_a_file_that_does_not_open_is_one_that_cannot_be_written(fifo: Path) -> None:
    with pytest.raises(ConfigError, match="cannot write the log file in") as caught:
        configure_logs(LogSettings(), fifo.parent)
    assert caught.value.reason is ConfigReason.UNREADABLE
    assert "does not open within" in str(caught.value)
    # The disk answers at last; the file must not stay open.
    reading = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    for thread in [each for each in threading.enumerate() if each.name == "opens the log file"]:
        thread.join(DEADLINE_S)
    os.close(reading)
