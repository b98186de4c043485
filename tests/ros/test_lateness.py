"""What is late on a busy computer is waited for; what is broken is missing."""

from __future__ import annotations

from math import inf

import pytest

from lsl_to_ros.live_table import (
    BUSY_PATIENCE_S,
    EXIT_BUSY,
    EXIT_MISSING,
    FIRST_SAMPLE_TIMEOUT_S,
    MOST_TIMES,
    PATIENCE_S,
    Waiting,
    summary,
    waiting_share,
)

ECG, HR, ACC = "/biosensors/polar_h10/ecg", "/biosensors/polar_h10/hr", "/biosensors/muse/acc"
ALL = {ECG: "", HR: "", ACC: "", "/biosensors/muse/aux": "it is switched off"}
STARTED_S, FIRST_S, ASKED_S = 100.0, 105.0, 20.0


def waiting(*, is_busy: bool = False, asked_s: float | None = ASKED_S, **came_s: float) -> Waiting:
    topics = {"ecg": ECG, "hr": HR, "acc": ACC}
    made = Waiting([each for each, reason in ALL.items() if not reason], STARTED_S, asked_s)
    made.is_busy = is_busy
    for name, at_s in came_s.items():
        made.came(topics[name], at_s)
    return made


def test_the_first_sample_may_take_longer_on_a_busy_computer() -> None:
    assert waiting().end_s == STARTED_S + FIRST_SAMPLE_TIMEOUT_S
    assert waiting(is_busy=True).end_s == STARTED_S + MOST_TIMES * FIRST_SAMPLE_TIMEOUT_S


@pytest.mark.parametrize("is_busy", [False, True])
def test_it_ends_as_asked_where_all_have_come(is_busy: bool) -> None:
    complete = waiting(is_busy=is_busy, ecg=FIRST_S, hr=110.0, acc=124.0)
    assert complete.end_s == FIRST_S + ASKED_S
    assert summary(complete, ALL) == (
        ["/biosensors/muse/aux: not expected, it is switched off"],
        0,
    )
    assert waiting(is_busy=is_busy, asked_s=None, ecg=FIRST_S).end_s == inf


def test_a_topic_that_comes_late_prolongs_the_wait_for_the_others() -> None:
    assert waiting(ecg=FIRST_S, hr=106.0).end_s == FIRST_S + ASKED_S
    assert waiting(ecg=FIRST_S, hr=124.0).end_s == 124.0 + PATIENCE_S
    assert waiting(is_busy=True, ecg=FIRST_S, hr=124.0).end_s == 124.0 + BUSY_PATIENCE_S
    # Not for ever.
    most = waiting(is_busy=True, ecg=FIRST_S, hr=FIRST_S + 2.9 * ASKED_S)
    assert most.end_s == FIRST_S + MOST_TIMES * ASKED_S


def test_what_does_not_come_is_missing_where_nothing_keeps_the_computer_busy() -> None:
    lines, code = summary(waiting(ecg=FIRST_S, hr=106.0), ALL)
    assert code == EXIT_MISSING
    assert f"{ACC}: MISSING" in lines
    assert not any("too busy" in line for line in lines)


def test_what_does_not_come_on_a_busy_computer_is_late() -> None:
    lines, code = summary(waiting(is_busy=True, ecg=120.0), ALL)
    assert code == EXIT_BUSY
    assert lines[-1] == "this computer is too busy: 2 topics have not come yet"
    assert not any("MISSING" in line for line in lines)
    lines, _ = summary(waiting(is_busy=True, ecg=120.0, hr=121.0), ALL)
    assert lines[-1] == "this computer is too busy: 1 topic has not come yet"
    # Nor is it missing where nothing has come at all.
    lines, code = summary(waiting(is_busy=True), ALL)
    assert (code, lines[-1]) == (
        EXIT_BUSY,
        "this computer is too busy: 3 topics have not come yet",
    )


def test_who_ends_it_early_is_told_what_has_not_come() -> None:
    stopped = waiting(is_busy=True, ecg=120.0)
    stopped.is_cut_short = True
    lines, code = summary(stopped, ALL)
    assert code == EXIT_MISSING
    assert lines[-2:] == [f"{HR}: not yet", f"{ACC}: not yet"]


def test_without_an_end_nothing_is_a_failure() -> None:
    lines, code = summary(waiting(asked_s=None, ecg=FIRST_S), ALL)
    assert code == 0
    assert f"{HR}: MISSING" in lines


def test_the_share_of_waiting_is_that_of_all_threads() -> None:
    assert waiting_share(["1000 3000 5", "1000 1000 2"]) == pytest.approx(4 / 6)
    assert waiting_share([]) is None
    assert waiting_share(["0 0 0"]) is None
