"""The limit of open files: which one is asked for, and how many streams fit below it."""

from __future__ import annotations

import errno
import sys
from pathlib import Path
from typing import NoReturn

import pytest

from biosensor_common import process_limits
from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.process_limits import INLET, MOST, OUTLET, RESERVE, fitting, wanted_limits

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
