"""From packets to samples: clocks, restarts, copies, losses and what comes now and then."""

from __future__ import annotations

import itertools
import json
from collections.abc import Generator, Sequence
from math import ceil, isnan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.refusal import Refusal
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.emotibit.driver.emitter import (
    EmotiBitEmitter,
    Oscillator,
    SensorRows,
)
from biosensor_gateway.devices.emotibit.driver.protocol import (
    NUMBERS,
    TIMES_MS,
    Packet,
    Tag,
    read,
    write,
)
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.emotibit.conftest import packet
from tests.rigs.driver_run import NotedSink

ACC = (Tag.ACC_X, Tag.ACC_Y, Tag.ACC_Z)


class Sender:
    """An emitter, and packets with their numbers and times for it."""

    def __init__(self) -> None:
        self.begin_s = LSL_CLOCK() - 100
        self.sink = NotedSink("emotibit")
        self.sink.open(DeviceInfo(), {"ppg": 25})
        self.emitter = EmotiBitEmitter(self.sink, 25)
        self.numbers = itertools.count()

    def send(self, time_ms: int, *packets: Sequence[str | float], late_s: float = 0.01) -> None:
        """Have packets arrive that were sent at a time; of each, tag and payload."""
        made = [packet(time_ms % TIMES_MS, self.number, *map(str, each)) for each in packets]
        self.take(made, time_ms, late_s=late_s)

    def take(self, packets: list[Packet], time_ms: int, *, late_s: float = 0.01) -> None:
        """Have packets arrive."""
        self.emitter.take(packets, self.begin_s + time_ms / 1000 + late_s)

    def send_acc(self, time_ms: int, value: float) -> None:
        """Send a sample of the acceleration."""
        self.send(time_ms, *((tag, value) for tag in ACC))

    @property
    def number(self) -> int:
        """The next packet's."""
        return next(self.numbers) % NUMBERS


@pytest.fixture
def sender() -> Generator[Sender]:
    made = Sender()
    yield made
    made.sink.close()


def test_times_and_numbers_turn_over(sender: Sender) -> None:
    sender.numbers = itertools.count(NUMBERS - 30)
    for count in range(50):
        sender.send_acc(TIMES_MS - 1000 + 40 * count, count)
    assert sender.sink.values("acc") == list(range(50))
    assert sender.sink.lost_count("acc") == 0
    np.testing.assert_allclose(np.diff(sender.sink.times["acc"]), 0.04, atol=2e-3)


def test_a_device_that_was_restarted_counts_again_and_nothing_is_lost_for_it(
    sender: Sender,
) -> None:
    for count in range(100):
        sender.send_acc(90_000 + 40 * count, count)
    sender.emitter.connected()
    sender.numbers = itertools.count()
    late_s = 95.0
    for count in range(100):
        made = [packet(1000 + 40 * count, sender.number, tag, str(count)) for tag in ACC]
        sender.take(made, 1000 + 40 * count, late_s=late_s)
    assert sender.sink.values("acc") == [*range(100), *range(100)]
    assert sender.sink.lost_count("acc") == 0
    assert np.all(np.diff(sender.sink.times["acc"]) > 0)


def test_a_copy_of_a_datagram_is_passed_over(sender: Sender) -> None:
    for count in range(20):
        made = [packet(1000 + 40 * count, sender.number, tag, str(count)) for tag in ACC]
        sender.take(made, 1000 + 40 * count)
        sender.take(made, 1000 + 40 * count)
    assert sender.sink.values("acc") == list(range(20))
    assert sender.sink.refusals.count(Refusal.LEFT_OUT) == 3 * 20


def test_datagrams_that_overtook_each_other_are_put_right(sender: Sender) -> None:
    for count in range(20):
        made = [packet(1000 + 40 * count, sender.number, tag, str(count)) for tag in ACC]
        sender.take(made[2:], 1000 + 40 * count)
        sender.take(made[:2], 1000 + 40 * count)
    assert sender.sink.rows["acc"] == [[count] * 3 for count in range(20)]
    assert sender.sink.lost_count("acc") == 0


def test_lost_datagrams_are_counted(sender: Sender) -> None:
    for count in range(100):
        if count in (50, 51, 52):
            for _ in ACC:
                sender.number  # noqa: B018 - they are counted, and do not come
        else:
            sender.send_acc(1000 + 40 * count, count)
    assert sender.sink.lost_count("acc") == 3
    assert np.abs(np.diff(sender.sink.times["acc"], 1) - 0.04).max() < 0.125


@pytest.mark.parametrize(
    ("there", "best"),
    [(["T0"], "T0"), (["T0", "T1"], "T1"), (["T1", "TH"], "TH"), (["TH"], "TH")],
)
def test_the_best_thermometer_is_taken(sender: Sender, there: list[str], best: str) -> None:
    for count in range(20):
        temperatures = [(tag, 30 + number) for number, tag in enumerate(there)]
        sender.send(1000 + 133 * count, ("EA", 0.5, 0.5), *temperatures)
    values = sender.sink.values("st")
    assert len(values) > 10
    assert set(values) == {30 + there.index(best)}


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e400", "ovf", ""])
@pytest.mark.parametrize(("tag", "data_name"), [("HR", "hr"), ("BI", "ibi"), ("B%", "bat")])
def test_what_is_no_number_is_not_sent_and_its_bytes_are_counted(
    sender: Sender, tag: str, data_name: str, text: str
) -> None:
    sender.send(1000, ("EA", 0.5), (tag, text), (tag, 60))
    assert len(sender.sink.rows[data_name]) == 1
    # Nothing at all is no value that came.
    assert sender.sink.dropped_bytes == len(text)


@pytest.mark.parametrize(
    ("tag", "value"),
    [*itertools.product(["BI"], [0, -800, 1e9, 20]), *itertools.product(["HR"], [0, -1, 400])],
)
def test_an_interval_or_a_rate_that_no_heart_has_is_refused(
    sender: Sender, tag: str, value: float
) -> None:
    sender.send(1000, ("EA", 0.5), (tag, value))
    assert sum(each.count(Refusal.IMPLAUSIBLE) for each in sender.sink.refused.values()) == 1


def test_intervals_of_one_packet_end_one_after_another(sender: Sender) -> None:
    sender.send(1000, ("EA", 0.5))
    sender.send(3000, ("EA", 0.5), ("BI", 800.0, 900.0), ("HR", 71))
    assert sender.sink.values("ibi") == [0.8, 0.9]
    assert np.diff(sender.sink.times["ibi"]) == pytest.approx(0.9, abs=1e-4)
    assert sender.sink.values("hr") == [71]
    assert sender.sink.times["hr"] == sender.sink.times["ibi"][1:]


def test_a_charge_is_told_when_it_changes(sender: Sender) -> None:
    for number, level in enumerate((81, 81, 80, 80)):
        sender.send(1000 + 1000 * number, ("EA", 0.5), ("B%", level))
    assert sender.sink.values("bat") == [81, 80]


@pytest.mark.parametrize(
    ("told", "row"),
    [
        (("DC", "PI", 2, "PR", 1), [3, 0]),
        (("DO", "EA", 4), [0, 4]),
        # Older firmware: a tag for each sample.
        (("DC", "PI", "PI", "PR"), [3, 0]),
    ],
)
def test_what_was_clipped_or_overflowed_is_told(
    sender: Sender, told: tuple[str | float, ...], row: list[float]
) -> None:
    sender.send(1000, ("EA", 0.5), told)
    assert sender.sink.rows["quality"] == [row]


def test_a_payload_that_is_no_numbers_is_dropped_and_counted(sender: Sender) -> None:
    for count in range(60):
        value = "x" if count == 30 else count
        sender.send(1000 + 67 * count, ("EA", value))
    assert sender.sink.dropped_bytes == 1
    assert sender.sink.lost_count("eda") == 1
    assert sender.sink.values("eda") == [count for count in range(60) if count != 30]


# Lines of text become packets, and packets rows on the device's clock.

# Channels side by side on the device's clock: even, complete, and what is missing counted.

READ_HZ = 75
ROUND_S = 0.1


class Sensor:
    """One of three channels that samples by an oscillator of its own, and is read by another."""

    def __init__(self, rate_hz: float, ppm: float) -> None:
        self.period_s = 1 / (rate_hz * (1 + ppm * 1e-6))
        late_s = 0.5 / READ_HZ if ppm else 0.0
        self.rows = SensorRows(rate_hz, 3, Oscillator(rate_hz, late_s))
        self.sent = 0
        self.times: list[float] = []
        self.values: list[list[float]] = []
        self.lost = 0

    def send(
        self, until_s: float, *, gap: bool = False, channels: tuple[int, ...] = (0, 1, 2)
    ) -> None:
        """Send what was read until a time, as one packet a channel."""
        look_s = ceil(until_s * READ_HZ - 1) / READ_HZ
        last = int(look_s / self.period_s + 1e-9)
        numbers = range(self.sent + 1, last + 1)
        if not numbers:
            return
        # It was read at the first look after the last sample.
        read_s = ceil(last * self.period_s * READ_HZ - 1e-9) / READ_HZ
        for channel in channels:
            stamp_s = int(read_s * 1000 + channel / 2) / 1000
            self.rows.add(channel, [10 * each + channel for each in numbers], stamp_s, gap=gap)
        self.sent = last
        self.take()

    def skip(self, until_s: float) -> None:
        """Measure, and send nothing."""
        self.sent = int(ceil(until_s * READ_HZ - 1) / READ_HZ / self.period_s + 1e-9)

    def take(self) -> None:
        """Take what is ready."""
        ready = self.rows.ready()
        self.times += ready.times_s
        self.values += ready.values
        self.lost += ready.lost

    @property
    def errors_s(self) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """How far each time is from that of measuring."""
        first = np.array([row[0] for row in self.values]) / 10
        return np.array(self.times) - first * self.period_s


KINDS = pytest.mark.parametrize(
    ("rate_hz", "ppm"),
    [(15, 0), (25, 900), (25, -1200), (100, 900), (7.5, 0), (25, 8000), (25, -8000)],
)


@KINDS
def test_samples_are_as_even_as_they_were_measured(rate_hz: float, ppm: float) -> None:
    sensor = Sensor(rate_hz, ppm)
    for round_number in range(1, 401):
        sensor.send(round_number * ROUND_S)
    numbers = [round(row[0] / 10) for row in sensor.values]
    assert numbers == list(range(1, len(numbers) + 1))
    assert sensor.values == [[10 * n, 10 * n + 1, 10 * n + 2] for n in numbers]
    assert sensor.lost == 0
    settled = sensor.errors_s[len(numbers) // 2 :]
    assert np.abs(settled).max() < 0.008
    assert np.sqrt(np.mean(np.diff(settled) ** 2)) < 0.5e-3
    assert np.all(np.diff(sensor.times) > 0)


@pytest.mark.parametrize(("rate_hz", "ppm"), [(15, 0), (25, 900), (25, -1200), (7.5, 0)])
@given(missing_s=st.floats(0.2, 60), begin_s=st.floats(20, 25))
def test_what_a_hole_cost_is_counted_by_the_rate_of_the_sensor(
    rate_hz: float, ppm: float, missing_s: float, begin_s: float
) -> None:
    sensor = Sensor(rate_hz, ppm)
    rounds = round(begin_s / ROUND_S)
    for round_number in range(1, rounds + 1):
        sensor.send(round_number * ROUND_S)
    sent = sensor.sent
    sensor.skip(rounds * ROUND_S + missing_s)
    skipped = sensor.sent - sent
    silent = sensor.sent
    sensor.rows.break_off()
    begin = len(sensor.times)
    for round_number in range(1, 30):
        sensor.send(
            rounds * ROUND_S + missing_s + round_number * ROUND_S, gap=sensor.sent == silent
        )
    assert sensor.lost == pytest.approx(skipped, abs=1)
    assert np.abs(sensor.errors_s[begin:]).max() < 0.02
    assert np.all(np.diff(sensor.times) > 0)


def test_a_channel_that_was_lost_is_no_value_in_whole_rows() -> None:
    sensor = Sensor(25, 0)
    for round_number in range(1, 31):
        channels = (0, 2) if round_number == 10 else (0, 1, 2)
        sensor.send(round_number * ROUND_S, channels=channels)
    without = [isnan(row[1]) for row in sensor.values]
    assert 2 <= sum(without) <= 3
    assert not any(isnan(row[0]) or isnan(row[2]) for row in sensor.values)
    assert sensor.lost == 0


def test_a_channel_that_comes_late_still_finds_its_rows() -> None:
    sensor = Sensor(25, 0)
    sensor.send(0.2)
    sensor.rows.add(2, [1002, 1012], 0.301, gap=False)
    sensor.rows.add(0, [1000, 1010], 0.300, gap=True)
    sensor.rows.add(1, [1001, 1011], 0.300, gap=False)
    sensor.take()
    assert sensor.values[-2:] == [[1000, 1001, 1002], [1010, 1011, 1012]]
    assert sensor.lost == 0


def test_what_is_incomplete_at_the_end_of_a_connection_is_lost() -> None:
    sensor = Sensor(25, 0)
    for round_number in range(1, 11):
        sensor.send(round_number * ROUND_S)
    before = len(sensor.values)
    sensor.send(1.1, channels=(0,))
    assert len(sensor.values) == before
    unfinished = sensor.sent - before
    sensor.rows.break_off()
    sensor.send(1.2, gap=True)
    assert not np.isnan(sensor.values).any()
    assert sensor.lost == unfinished > 0


# Lines of text, against vectors and against any bytes.
VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/emotibit_packets.json").read_text(encoding="utf-8")
)
REAL = "".join(each["text"] for each in VECTORS if each["name"].startswith("real_")).encode()


@pytest.mark.parametrize("vector", VECTORS, ids=[each["name"] for each in VECTORS])
def test_a_datagram_is_read_as_it_was_meant(vector: dict[str, Any]) -> None:
    found = read(vector["text"].encode())
    told = [
        {
            "time_ms": each.time_ms,
            "number": each.number,
            "tag": each.tag,
            "values": None if each.values() is None else list(each.values() or ()),
        }
        for each in found.packets
    ]
    assert told == vector["expected"]
    assert found.dropped_bytes == vector["dropped_bytes"]


def test_labels_are_found_wherever_they_stand() -> None:
    (packet,) = read(b"1,2,4,HH,1,100,DP,-1,DI,MD-V5-0000123\n").packets
    assert (packet.labelled("DI"), packet.labelled("DP")) == ("MD-V5-0000123", "-1")
    assert packet.labelled("-1") is None


@given(
    st.sampled_from(Tag),
    st.integers(0, 2 * NUMBERS),
    st.lists(st.from_regex(r"[A-Za-z0-9.\-]{0,12}", fullmatch=True), max_size=8),
    st.integers(0, TIMES_MS - 1),
)
def test_what_is_written_is_read(tag: Tag, number: int, payload: list[str], time_ms: int) -> None:
    found = read(write(tag, number, payload, time_ms))
    assert found.packets == [(time_ms, number % NUMBERS, tag, tuple(payload))]
    assert found.dropped_bytes == 0


@given(st.integers(0, len(REAL) - 1), st.integers(0, 255))
def test_a_wrong_byte_costs_no_more_than_its_line(at: int, byte: int) -> None:
    damaged = REAL[:at] + bytes([byte]) + REAL[at + 1 :]
    good = set(read(REAL).packets)
    assert len(good - set(read(damaged).packets)) <= 2


@given(st.integers(0, len(REAL)))
def test_of_a_cut_datagram_whole_lines_are_kept(at: int) -> None:
    whole = read(REAL[: REAL.rfind(b"\n", 0, at) + 1]).packets
    assert read(REAL[:at]).packets[: len(whole)] == whole


@given(st.binary(max_size=300))
def test_any_bytes_are_read(data: bytes) -> None:
    found = read(data)
    assert 0 <= found.dropped_bytes <= len(data)
    for each in found.packets:
        assert each.number < NUMBERS
        assert each.time_ms < TIMES_MS
        each.values()
