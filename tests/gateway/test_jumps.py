"""A device's clock that jumps all the time floods neither the log nor the events."""

from __future__ import annotations

from collections.abc import Generator

import pytest
from structlog.testing import capture_logs

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.sink import (
    JUMPS_SAID,
    JUMPS_SAID_WITHIN_S,
    DeviceSink,
    JumpReports,
    Jumps,
)
from tests.rigs.set_clock import SetClock


@pytest.fixture
def clock() -> SetClock:
    return SetClock()


@pytest.fixture
def said() -> list[Jumps]:
    return []


@pytest.fixture
def reports(clock: SetClock, said: list[Jumps]) -> JumpReports:
    return JumpReports(clock, said.append)


@pytest.fixture
def sink(clock: SetClock, unit: str) -> Generator[DeviceSink]:
    made = DeviceSink(DeviceIdentity("zephyr", unit), declaration("zephyr"), clock)
    made.open(DeviceInfo(), {})
    yield made
    made.close()


def test_few_are_said_one_by_one(reports: JumpReports, said: list[Jumps]) -> None:
    reports.note("below", 1.5)
    reports.note("device_restarted", None)
    assert said == [Jumps("below", 1.5), Jumps("device_restarted", None)]


def test_many_are_said_together_when_their_time_has_come(
    reports: JumpReports, said: list[Jumps], clock: SetClock
) -> None:
    for number in range(JUMPS_SAID + 500):
        clock.now_s += 0.01
        reports.note("below" if number % 2 else "device_backward", -3.0 if number % 2 else 3.5)
        reports.release()
    assert len(said) == JUMPS_SAID
    del said[:]
    clock.now_s += JUMPS_SAID_WITHIN_S
    reports.release()
    ((cause, seconds, times),) = said
    assert (cause, times) == ("device_backward", 500)
    assert seconds == pytest.approx(250 * 0.5)
    reports.release()
    assert len(said) == 1


def test_what_is_not_said_yet_is_said_at_the_end(reports: JumpReports, said: list[Jumps]) -> None:
    for _ in range(JUMPS_SAID + 2):
        reports.note("below", 1.0)
    reports.note("device_restarted", None)
    reports.finish()
    reports.finish()
    assert said[JUMPS_SAID:] == [Jumps("device_restarted", None, 3)]


def test_a_clock_that_jumps_there_and_back_is_said_a_few_times_and_counted_always(
    sink: DeviceSink,
) -> None:
    with capture_logs() as logs:
        for number in range(1000):
            sink.observe(8.2e8 + 3600.0 * (number % 2), 1000.0 + 0.01 * number)
        sink.close()
    told = [entry for entry in logs if "jumped" in entry["event"]]
    assert sink.clock_state.reanchors == 999
    assert [entry.get("times", 1) for entry in told] == [1] * JUMPS_SAID + [999 - JUMPS_SAID]
