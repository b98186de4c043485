"""When the computer is kept awake, and what is said of it."""

from __future__ import annotations

from typing import Any

from structlog.testing import capture_logs

from biosensor_gateway.system.keep_awake import GRACE_S, RETRY_S, KeepAwake
from tests.rigs.set_clock import SetClock

KEPT = "the computer is kept from sleeping while a device streams"
LET_GO = "the computer may go to sleep again"
WARNED = "the computer may go to sleep while a device streams"


class Recorder:
    """A system that writes down what is asked of it."""

    way = "recorder"

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.refusal: OSError | None = None
        self.agreed = True

    def begin(self) -> None:
        self.calls.append("begin")
        if self.refusal:
            raise self.refusal

    def held(self) -> bool:
        if self.refusal:
            raise self.refusal
        return self.agreed

    def end(self) -> None:
        self.calls.append("end")


def events(logs: list[Any]) -> list[str]:
    return [entry["event"].split(";")[0] for entry in logs]


def every_second(awake: KeepAwake, clock: SetClock, seconds: float, *, wanted: bool) -> None:
    end = clock.now_s + seconds
    while clock.now_s < end:
        awake.hold(wanted)
        clock.now_s += 1.0


def test_it_is_held_once_and_let_go_once_a_grace_period_after_the_last_stream() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    with capture_logs() as logs:
        every_second(awake, clock, 10, wanted=False)
        assert system.calls == []
        every_second(awake, clock, 600, wanted=True)
        # The last stream was seen a second ago.
        every_second(awake, clock, GRACE_S - 1, wanted=False)
        assert system.calls == ["begin"]
        every_second(awake, clock, 600, wanted=False)
        assert system.calls == ["begin", "end"]
        awake.close()
    assert system.calls == ["begin", "end"]
    assert [(entry["event"], entry["log_level"]) for entry in logs] == [
        (KEPT, "info"),
        (LET_GO, "info"),
    ]


def test_a_device_that_drops_out_for_less_is_no_end() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    for _ in range(5):
        every_second(awake, clock, 5, wanted=True)
        every_second(awake, clock, GRACE_S - 2, wanted=False)
    assert system.calls == ["begin"]


def test_closing_ends_it_without_a_grace_period_and_it_can_be_held_again() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    awake.hold(True)
    awake.close()
    awake.hold(False)
    assert system.calls == ["begin", "end"]
    awake.hold(True)
    assert system.calls == ["begin", "end", "begin"]


def test_after_a_long_sleep_it_is_asked_for_again() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    awake.hold(True)
    clock.now_s += GRACE_S
    awake.hold(True)
    assert system.calls == ["begin", "end", "begin"]


def test_a_refusal_is_said_once_and_the_system_is_asked_again_after_a_while() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    system.refusal = PermissionError("not you")
    with capture_logs() as logs:
        every_second(awake, clock, 3 * RETRY_S, wanted=True)
        assert system.calls == ["begin", "end"] * 3
        (warning,) = logs
        system.refusal = None
        every_second(awake, clock, RETRY_S, wanted=True)
    assert (warning["log_level"], warning["error"]) == ("warning", "not you")
    assert events(logs) == [WARNED, KEPT]
    assert system.calls[-1] == "begin"


def test_it_is_not_said_to_be_held_before_the_system_has_agreed() -> None:
    clock, system = SetClock(), Recorder()
    awake = KeepAwake(system, clock)
    system.agreed = False
    with capture_logs() as logs:
        every_second(awake, clock, 5, wanted=True)
        assert logs == []
        system.agreed = True
        every_second(awake, clock, 5, wanted=True)
    assert system.calls == ["begin"]
    assert events(logs) == [KEPT]
