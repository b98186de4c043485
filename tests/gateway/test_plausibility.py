"""What cannot be is not sent, but counted and said: for every sensor, by its declaration."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import ArrayLike
from structlog.testing import capture_logs

from biosensor_common.errors import SpecError
from biosensor_common.naming import source_id
from biosensor_common.quantities import NOT_PHYSICAL, Unit
from biosensor_common.refusal import LATELY_S
from biosensor_common.spec import ChannelSpec, DeviceIdentity, DeviceInfo
from biosensor_gateway.agent.device_set import Device
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.bluetooth_health.driver import HealthEmitter
from biosensor_gateway.devices.bluetooth_health.driver.services import ROWS
from biosensor_gateway.devices.registry import declaration, declaration_names
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.streaming.stages import AHEAD_LIMIT_S
from biosensor_gateway.system.clock import LslClock

CHANNELS = [
    pytest.param(channel, id=f"{name}/{stream.data_name}/{channel.label}")
    for name in declaration_names()
    for stream in declaration(name).streams
    for channel in stream.channels
]


class _Time(LslClock):
    """A clock that goes on when it is told to."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


class _Sent:
    """A sink, and what it sent."""

    def __init__(self, sensor: str) -> None:
        self.time = _Time()
        self.sink = DeviceSink(DeviceIdentity(sensor, "1"), declaration(sensor), self.time)
        self.rows: dict[str, list[list[float]]] = {}
        self.sink.tap = self._take
        self.sink.open(DeviceInfo(), {})

    def emit(self, data_name: str, samples: ArrayLike) -> None:
        """Emit samples of now."""
        self.sink.emit_at(data_name, samples, [self.time.now_s] * len(np.asarray(samples)))

    def counters(self, data_name: str) -> Counters:
        return self.sink.counters[source_id(self.sink.identity, data_name)]

    def status(self) -> str:
        """Return what is said of the device."""
        device = Device(Supervisor(lambda: pytest.fail("nobody connects"), self.sink), self.sink)
        told = device.status()
        assert told.error is None
        return "; ".join(
            f"{source.rpartition('-')[2]}: {each.sentence}"
            for source, stream in sorted(told.streams.items())
            for each in stream.refusals
            if each.now
        )

    def _take(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        rows = np.asarray(samples, np.float64).reshape(len(stamps), -1)
        self.rows.setdefault(data_name, []).extend(rows.tolist())


@pytest.mark.parametrize("channel", CHANNELS)
def test_what_has_a_physical_unit_has_bounds_or_says_why_not(channel: ChannelSpec) -> None:
    assert channel.unit not in set(Unit) or (channel.plausible is None) == (
        channel.unit in NOT_PHYSICAL
    )


def test_bounds_without_a_value_between_them_are_none() -> None:
    with pytest.raises(SpecError, match="between 3 and 2 there is no value"):
        ChannelSpec("speed", Unit.METRES_PER_SECOND, plausible=(3.0, 2.0))


def test_a_value_that_cannot_be_is_left_out_counted_and_said() -> None:
    sent = _Sent("bluetooth_health")
    with capture_logs() as logs:
        for speed in (9.04e9, 9.1e9, 3.0):
            sent.emit("cycling", [[speed, 90.0]])
        sent.emit("temp", [1e127])
    assert str(sent.rows["cycling"]) == "[[nan, 90.0], [nan, 90.0], [3.0, 90.0]]"
    assert "temp" not in sent.rows
    assert (sent.counters("cycling").refused, sent.counters("cycling").pushed) == (2, 3)
    assert (sent.counters("temp").refused, sent.counters("temp").pushed) == (1, 0)
    assert sent.status() == (
        "cycling: 2 samples were not sent: speed was 9.1e+09 m/s, which is not between 0 and 50; "
        "temp: 1 sample was not sent: body was 1e+127 celsius, which is not between -50 and 100"
    )
    # Once for each stream.
    assert [entry["data"] for entry in logs] == ["cycling", "temp"]
    sent.time.now_s += LATELY_S + 1
    assert sent.status() == ""
    sent.sink.close()


def test_a_regular_stream_keeps_its_pace() -> None:
    sent = _Sent("polar_h10")
    sent.emit("acc", [[0.0, 0.0, 1.0], [math.inf, 0.0, 1e30], [0.0, 0.0, 1.0]])
    sent.emit("ecg", [1.0, 1e9, 2.0])
    assert str(sent.rows["acc"][1]) == "[nan, 0.0, nan]"
    assert str(sent.rows["ecg"]) == "[[1.0], [nan], [2.0]]"
    assert (sent.counters("acc").refused, sent.counters("ecg").refused) == (1, 1)
    sent.sink.close()


def test_whole_numbers_that_cannot_be_are_left_out() -> None:
    sent = _Sent("zephyr")
    sent.emit("hr", [400, 70])
    assert sent.rows["hr"] == [[70.0]]
    assert sent.counters("hr").refused == 1
    sent.sink.close()


@pytest.mark.parametrize("step", [1, 400_000], ids=["backwards", "again"])
def test_a_wheel_whose_count_steps_back_has_no_speed(step: int) -> None:
    sent = _Sent("bluetooth_health")
    emitter = HealthEmitter(sent.sink, 2.105)
    row = next(row for row in ROWS if row.stream == "cycling")
    count = 457371
    for second, turns in enumerate((0, 2, -step, 2, 2)):
        count += turns
        sent.time.now_s += 1.0
        emitter.take(row, struct.pack("<BIH", 1, count, 1024 * (second + 1)), sent.time.now_s)
    assert [speed for speed, _ in sent.rows["cycling"]] == pytest.approx([4.21] * 3)
    assert sent.counters("cycling").refused == 1
    assert f"speed was {-2.105 * step:g} m/s" in sent.status()
    sent.sink.close()


def _pulse(emitter: StrapEmitter, intervals_s: Sequence[float], now_s: float) -> None:
    values = [round(1024 * each) for each in intervals_s]
    emitter.measurement(struct.pack(f"<BB{len(values)}H", 0x10, 72, *values), now_s)


def _beats(sent: _Sent, seconds: int, repeated: int) -> float:
    """Have a strap repeat so many intervals in each packet; return the sum of what was sent."""
    emitter, heart = StrapEmitter(sent.sink), np.random.default_rng(3)
    history, next_s = list[float](), 0.8
    for second in range(1, seconds):
        sent.time.now_s += 1.0
        new = list[float]()
        while next_s <= second:
            new.append(0.8 + 0.05 * float(heart.random()))
            next_s += new[-1]
        history += new
        told = history[-(len(new) + repeated) :] if repeated else new
        _pulse(emitter, told, sent.time.now_s)
    return sum(interval for (interval,) in sent.rows["ibi"])


@pytest.mark.parametrize("repeated", [1, 2])
def test_intervals_that_are_told_twice_are_not_sent_for_long(repeated: int) -> None:
    sent = _Sent("ble_heart_rate")
    assert _beats(sent, 300, repeated) < 2 * AHEAD_LIMIT_S + 20
    assert sent.counters("ibi").refused > 300
    assert "intervals between beats add up to more than the time that has passed" in sent.status()
    sent.sink.close()


@pytest.mark.parametrize("repeated", [1, 2])
def test_a_strap_that_repeats_beats_is_noticed_after_a_few_and_what_was_sent_is_told(
    repeated: int,
) -> None:
    sent = _Sent("ble_heart_rate")
    _beats(sent, 12, repeated)
    told = [value for (value,) in sent.rows["ibi"]]
    twice = len(told) - len(set(told))
    assert 0 < twice <= 4
    assert f"so some are told twice; {twice} told twice before were sent" in sent.status()
    sent.sink.close()


@pytest.mark.parametrize("seed", range(20))
def test_beats_of_a_pacemaker_that_arrive_in_bundles_are_believed(seed: int) -> None:
    # Each is like the one before.
    sent, chance = _Sent("ble_heart_rate"), np.random.default_rng(seed)
    due_s = sent.time.now_s
    for _ in range(200):
        count = int(chance.integers(1, 5))
        due_s += 0.75 * count
        sent.time.now_s = max(sent.time.now_s, due_s + float(chance.uniform(0.0, 0.5)))
        sent.emit("ibi", [0.75] * count)
    assert sent.counters("ibi").refused == 0
    sent.sink.close()


def test_intervals_of_a_heart_are_believed_also_after_a_pause_and_what_was_stored() -> None:
    sent = _Sent("ble_heart_rate")
    assert _beats(sent, 300, 0) == pytest.approx(298, abs=3)
    sent.time.now_s += 40.0
    sent.emit("ibi", [0.8] * 48)
    for _ in range(100):
        sent.time.now_s += 0.8
        sent.emit("ibi", [0.8])
    assert sent.counters("ibi").refused == 0
    assert sent.status() == ""
    sent.sink.close()
