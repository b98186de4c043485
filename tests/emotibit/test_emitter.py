"""From packets to samples: clocks, restarts, copies, losses and what comes now and then."""

from __future__ import annotations

import itertools
from collections.abc import Generator, Sequence

import numpy as np
import pytest

from biosensor_common.refusal import Refusal
from biosensor_common.spec import DeviceInfo
from biosensor_gateway.devices.emotibit.driver.emitter import EmotiBitEmitter
from biosensor_gateway.devices.emotibit.driver.protocol import NUMBERS, TIMES_MS, Packet, Tag
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


@pytest.mark.parametrize("interval_ms", [0, -800, 1e9, 20])
def test_an_interval_that_no_heart_has_is_refused(sender: Sender, interval_ms: float) -> None:
    sender.send(1000, ("EA", 0.5), ("BI", interval_ms))
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
