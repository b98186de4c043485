"""From a driver's samples to stamped, counted ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator

import numpy as np
import pylsl
import pytest
from structlog.testing import capture_logs

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.sink import WAITED_S, Arrivals, DeviceSink

ECG_PERIOD_S = 0.004
DEVICE_S = 8.2e8

OpenInlet = Callable[[str], pylsl.StreamInlet]


@pytest.fixture
def sink(unit: str) -> Generator[DeviceSink]:
    opened = DeviceSink(DeviceIdentity("zephyr", unit), declaration("zephyr"))
    opened.open(DeviceInfo(), {})
    yield opened
    opened.close()


def counters(sink: DeviceSink, data_name: str) -> Counters:
    return sink.counters[f"zephyr-{sink.identity.unit}-{data_name}"]


def times(count: int, start_s: float = DEVICE_S) -> list[float]:
    return [start_s + ECG_PERIOD_S * index for index in range(count)]


@pytest.mark.seam
def test_device_times_become_lsl_stamps(sink: DeviceSink, inlet: OpenInlet) -> None:
    reader = inlet(f"zephyr-{sink.identity.unit}-ecg")
    arrival = pylsl.local_clock()
    device_times = times(63)
    sink.observe(device_times[-1], arrival)
    sink.emit("ecg", list(range(63)), device_times)
    for index in range(63):
        sample, stamp = reader.pull_sample(timeout=20.0)
        assert sample == [index]
        # The packet's last sample was measured when it arrived; the others 4 ms apart.
        assert stamp == pytest.approx(arrival - (62 - index) * ECG_PERIOD_S, abs=1e-6)
    assert counters(sink, "ecg").pushed == 63


@pytest.mark.nightly
def test_stamps_never_run_backwards_when_the_device_clock_does(
    sink: DeviceSink, inlet: OpenInlet
) -> None:
    reader = inlet(f"zephyr-{sink.identity.unit}-ecg")
    arrival = pylsl.local_clock()
    with capture_logs() as logs:
        for start_s, lag_s in ((DEVICE_S, 0.0), (DEVICE_S - 3600, 0.1), (DEVICE_S + 3600, 0.2)):
            device_times = times(63, start_s)
            sink.observe(device_times[-1], arrival + lag_s)
            sink.emit("ecg", [1.0] * 63, device_times)
    stamps = [reader.pull_sample(timeout=20.0)[1] or math.nan for _ in range(189)]
    assert stamps == sorted(set(stamps))
    assert counters(sink, "ecg") == Counters(pushed=189, last_stamp=stamps[-1])
    jumps = [entry for entry in logs if "jumped" in entry["event"]]
    assert [entry["unit"] for entry in jumps] == [sink.identity.unit] * 2
    assert sink.clock_state.reanchors == 2


@pytest.mark.parametrize(("own_delay_s", "reanchors"), [(0.0, 1), (0.3, 0)])
def test_what_waits_for_a_busy_computer_is_no_step_of_the_device_clock(
    sink: DeviceSink, own_delay_s: float, reanchors: int
) -> None:
    sink.own_delay = lambda: own_delay_s
    begin = pylsl.local_clock() - 20.0
    for packet in range(200):
        late_s = 0.3 if packet > 100 else 0.0
        sink.observe(DEVICE_S + 0.1 * packet, begin + 0.1 * packet + late_s)
    assert sink.clock_state.reanchors == reanchors


@pytest.mark.parametrize("value", [0, 71])
def test_a_value_is_sent(sink: DeviceSink, value: int) -> None:
    sink.observe(DEVICE_S, pylsl.local_clock())
    sink.emit_value("hr", value, DEVICE_S)
    assert counters(sink, "hr").pushed == 1


def test_no_value_sends_nothing_and_refuses_nothing(sink: DeviceSink) -> None:
    sink.observe(DEVICE_S, pylsl.local_clock())
    sink.emit_value("hr", None, DEVICE_S)
    assert counters(sink, "hr") == Counters()


def test_a_cause_of_refusals_is_logged_once_and_counted_always(sink: DeviceSink) -> None:
    sink.observe(DEVICE_S, pylsl.local_clock())
    with capture_logs() as logs:
        for value in (256, 71, 299, 256):
            sink.emit_value("hr", value, DEVICE_S)
        sink.emit_value("ecg", math.inf, DEVICE_S)
    refusals = [entry for entry in logs if entry["log_level"] == "error"]
    assert [entry["data"] for entry in refusals] == ["hr", "ecg"]
    assert "outside 0..255" in refusals[0]["cause"]
    assert (counters(sink, "hr").refused, counters(sink, "hr").pushed) == (3, 1)


@pytest.mark.parametrize("waited_s", [45.0, 89.0])
def test_what_waited_for_an_agent_that_did_not_run_is_late_and_not_refused(
    sink: DeviceSink, waited_s: float
) -> None:
    now = pylsl.local_clock()
    sink.observe(DEVICE_S, now - waited_s - 1.0)
    sink.observe(DEVICE_S + 1.0, now)
    sink.emit("ecg", [1.0] * 63, times(63, DEVICE_S + 0.748))
    assert (counters(sink, "ecg").refused, counters(sink, "ecg").pushed) == (0, 63)
    assert counters(sink, "ecg").last_stamp == pytest.approx(now - waited_s, abs=0.1)


def test_losses_are_counted_per_stream(sink: DeviceSink) -> None:
    sink.lost("ecg", 63)
    sink.lost("ecg", 126)
    assert counters(sink, "ecg").lost == 189
    assert counters(sink, "acc").lost == 0


def test_counters_outlive_a_connection(sink: DeviceSink) -> None:
    sink.lost("ecg", 63)
    sink.open(DeviceInfo(firmware_version="2"), {})
    assert counters(sink, "ecg").lost == 63


def test_samples_are_signs_of_life_of_their_streams(unit: str) -> None:
    sink = DeviceSink(DeviceIdentity("polar_h10", unit), declaration("polar_h10"))
    sink.open(DeviceInfo(), {"ecg": 130.0, "acc": 50.0})
    assert sink.spec.rates({"acc": 25.0})["acc"] == 25.0
    sink.watch.expect({"ecg": 0.0, "acc": 0.0, "hr": 0.0})
    judged = sink.watch.judge(can_enable=True)
    assert judged is not None
    assert sink.watch.absent == {"ecg", "acc", "hr"}
    sink.emit_at("ecg", [[1.0]], [pylsl.local_clock()])
    sink.heard("hr")
    assert sink.watch.take_came_back() == {"ecg", "hr"}
    # Also what is withheld or refused has come.
    sink.pause()
    sink.emit_at("acc", [[1.0]], [pylsl.local_clock()])
    assert not sink.watch.absent
    sink.close()


def test_every_declared_stream_has_its_counters(sink: DeviceSink) -> None:
    assert len(sink.counters) == 13
    assert all(each == Counters() for each in sink.counters.values())


def test_a_stamp_from_the_future_is_refused_and_holds_nothing_back(sink: DeviceSink) -> None:
    now = pylsl.local_clock()
    sink.emit_at("ecg", [1.0], [now + 3600])
    sink.emit_at("ecg", [2.0, 3.0], [now, now + ECG_PERIOD_S])
    counted = counters(sink, "ecg")
    assert (counted.refused, counted.pushed) == (1, 2)
    assert counted.last_stamp == pytest.approx(now + ECG_PERIOD_S)


@pytest.mark.parametrize("held_s", [1.5, 2.5, 7.2])
def test_all_that_waited_together_is_told_and_the_rest_is_less_than_a_period_late(
    held_s: float,
) -> None:
    """A strap without device times sends a heart rate each second; the link holds them at first."""
    for phase_s in np.arange(0.05, 1.0, 0.1):
        told: list[int] = []
        arrivals = Arrivals(lambda _name, count, _seconds, told=told: told.append(count))
        arrivals.note("hr", 0.0, 1)
        errors_s: list[float] = []
        for number in range(20):
            measured_s = 100.0 - held_s + phase_s + number
            arrival_s = max(100.0 + 0.01 * number, measured_s)
            assert not arrivals.waited_s(arrival_s)
            arrivals.note("hr", arrival_s, 1)
            errors_s.append(arrival_s - measured_s)
        late = sum(error_s > WAITED_S for error_s in errors_s)
        if errors_s[1] > 0.0:
            assert late <= sum(told) <= held_s + 2
        else:
            # One that waited alone: nothing tells so, and the next one came in time.
            assert max(errors_s) < 1.0
