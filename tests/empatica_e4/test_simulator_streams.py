"""The data of the virtual E4 server: rates, bursts, delays, stamps, and the truth."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.devices.empatica_e4.simulator import Timing
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import LSL_CLOCK
from tests.empatica_e4.steering import SteeredE4

STEPS_S = {
    "E4_Bvp": 1 / 63.997,
    "E4_Acc": 1 / 32,
    "E4_Gsr": 1 / 4,
    "E4_Temperature": 1 / 4,
}
DATA_NAMES = {
    "E4_Bvp": "bvp",
    "E4_Acc": "acc",
    "E4_Gsr": "gsr",
    "E4_Temperature": "st",
    "E4_Hr": "hr",
    "E4_Ibi": "ibi",
    "E4_Battery": "bat",
}
# A stamp has steps of 10 us.
ROUNDING_S = 1.1e-5


def gather(client: Any, beats: int = 4) -> None:
    client.begin()
    client.until_lines("E4_Ibi", beats)


def declared(word: str, values: tuple[float, ...]) -> list[float]:
    """Values of a line in the units of the declaration."""
    match word:
        case "E4_Acc":
            return [value / 64 for value in values]
        case "E4_Battery":
            return [100 * values[0]]
        case "E4_Gsr":
            return [values[0] or np.nan]
        case _:
            return list(values)


def assert_equals_truth(server: SteeredE4, client: Any, *words: str) -> None:
    """What a client read is what was noted, from the first line on and in order."""
    for word in words or DATA_NAMES:
        lines = client.lines(word)
        assert lines, word
        truth = server.truth.samples(DATA_NAMES[word]).values[: len(lines)]
        np.testing.assert_allclose([declared(word, line.values) for line in lines], truth)


def test_stamps_count_samples_by_the_nominal_rate(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, jitter_s=0.05, drift_ppm=200) as server,
        line_client(server.settings) as client,
    ):
        client.begin()
        client.until_lines("E4_Gsr", 12)
    for word, step_s in STEPS_S.items():
        stamps = [line.stamp for line in client.lines(word)]
        assert len(stamps) >= 12
        assert all(abs(b - a - step_s) < ROUNDING_S for a, b in pairwise(stamps)), word


def test_the_reference_is_the_begin_of_the_radio_link(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, automatic=False) as server,
        line_client(server.settings) as first,
        line_client(server.settings) as second,
    ):
        first.ask("device_connect_btle 9ff167")
        first.begin(streams="bvp")
        first.until_lines("E4_Bvp", 100)
        second.begin(streams="bvp acc")
        second.until_lines("E4_Acc", 1)
        step_s = STEPS_S["E4_Bvp"]
        begin = first.lines("E4_Bvp")[0].stamp
        numbers = (second.lines("E4_Bvp")[0].stamp - begin) / step_s
        assert numbers > 90
        assert numbers == pytest.approx(round(numbers), abs=2e-3)


def test_conductance_and_temperature_come_in_bursts(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp gsr tmp")
        client.until_lines("E4_Temperature", 18)
    words = [line.split(maxsplit=1)[0].decode() for line in client.data]
    for word in ("E4_Gsr", "E4_Temperature"):
        places = [place for place, each in enumerate(words) if each == word]
        runs = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
        assert [len(run) for run in runs[:-1]] == [6] * (len(runs) - 1)
        assert len(runs) >= 3


def test_beats_come_late_and_the_rate_before_the_interval(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        gather(client)
        rates, intervals = client.lines("E4_Hr"), client.lines("E4_Ibi")
        newest_bvp = client.lines("E4_Bvp")[-1].stamp
    assert 5.5 < newest_bvp - intervals[-1].stamp < 5.7
    order = [line[:6] for line in client.data if line[:6] in (b"E4_Hr ", b"E4_Ibi")]
    assert order[::2] == [b"E4_Hr "] * len(intervals)
    assert order[1::2] == [b"E4_Ibi"] * len(intervals)
    for rate, interval in zip(rates, intervals, strict=True):
        assert rate.stamp == interval.stamp
        assert rate.values[0] * interval.values[0] == pytest.approx(60, abs=1e-4)
    for before, after in pairwise(intervals):
        assert after.stamp - before.stamp == pytest.approx(after.values[0], abs=2 * ROUNDING_S)


def test_beats_are_those_of_the_wearer(world: World, line_client: Any) -> None:
    wearer = Wearer(1, heart_rate_bpm=90)
    with (
        SteeredE4(world, timing=Timing(beat_delay_s=0.0), wearer=wearer) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="ibi")
        client.until_lines("E4_Ibi", 8)
        rates = [line.values[0] for line in client.lines("E4_Hr")]
    # Swing and steps of 1/64 s.
    assert all(90 * 0.94 < rate < 90 * 1.07 for rate in rates)


def test_bvp_may_come_later_than_conductance(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, timing=Timing(bvp_delay_s=0.065)) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bvp gsr")
        client.until_lines("E4_Gsr", 12)
        newest = client.lines("E4_Gsr")[11].stamp
        index = client.data.index(client.raw("E4_Gsr")[11])
        bvp = [line for line in client.data[:index] if line.startswith(b"E4_Bvp")]
    ahead = newest - float(bvp[-1].split()[1].replace(b",", b"."))
    assert 0.045 < ahead < 0.085


def test_the_charge_comes_at_its_interval(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, timing=Timing(battery_interval_s=0.5)) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bat")
        client.until_lines("E4_Battery", 3)
        server.apply(Fault(FaultKind.LOW_BATTERY, 4))
        client.until(lambda: client.lines("E4_Battery")[-1].values == (0.04,))
        lines = client.lines("E4_Battery")
        assert_equals_truth(server, client, "E4_Battery")
    assert lines[0].values == (0.82,)
    for before, after in pairwise(lines):
        assert after.stamp - before.stamp == pytest.approx(0.5, abs=2 * ROUNDING_S)


def test_a_button_press_is_a_line_without_value(world: World, line_client: Any) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="bvp tag")
        client.until_lines("E4_Bvp", 5)
        before = LSL_CLOCK()
        server.press_button()
        after = LSL_CLOCK()
        client.until_lines("E4_Tag", 1)
        (tag,) = client.lines("E4_Tag")
        (truth,) = server.truth.samples("tag").times
        assert tag.values == ()
        assert before <= truth <= after
        # Stamps and truth have the same distance in both streams: there is no drift.
        first = client.lines("E4_Bvp")[0].stamp - server.truth.samples("bvp").times[0]
        assert tag.stamp - truth == pytest.approx(first, abs=1e-4)


def test_the_oscillator_drifts_against_the_stamps(world: World, line_client: Any) -> None:
    with (
        SteeredE4(world, drift_ppm=5000) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bvp acc")
        client.until_lines("E4_Bvp", 130)
        for word, name in (("E4_Bvp", "bvp"), ("E4_Acc", "acc")):
            stamps = np.array([line.stamp for line in client.lines(word)])
            times = server.truth.samples(name).times[: len(stamps)]
            speed = (stamps[-1] - stamps[0]) / (times[-1] - times[0])
            assert speed == pytest.approx(1.005, abs=1e-4)
        server.apply(Fault(FaultKind.DRIFT, -5000))
        # Sent by now, whether the client has read it or not.
        count = len(server.truth.samples("bvp").times) + 10
        client.until_lines("E4_Bvp", count + 130)
        stamps = np.array([line.stamp for line in client.lines("E4_Bvp")[count:]])
        times = server.truth.samples("bvp").times[count : count + len(stamps)]
        speed = (stamps[-1] - stamps[0]) / (times[-1] - times[0])
        assert speed == pytest.approx(0.995, abs=1e-4)


def test_nothing_arrives_before_it_is_measured_nor_out_of_order(
    world: World, line_client: Any
) -> None:
    with (
        SteeredE4(world, jitter_s=0.1) as server,
        line_client(server.settings) as client,
    ):
        client.begin(streams="bvp acc gsr")
        arrivals: list[float] = []
        while len(client.raw("E4_Bvp")) < 100:
            line = client.read()
            if line.startswith(b"E4_Bvp"):
                arrivals.append(LSL_CLOCK())
        stamps = [line.stamp for line in client.lines("E4_Bvp")][-len(arrivals) :]
        times = server.truth.samples("bvp").times[: len(client.raw("E4_Bvp"))][-len(arrivals) :]
    assert stamps == sorted(stamps)
    assert all(arrival >= time for arrival, time in zip(arrivals, times, strict=True))


def test_equal_wearers_measure_equal_things(world: World, line_client: Any) -> None:
    wearer = Wearer(4)
    t = np.arange(0, 30.0, 0.01)
    with SteeredE4(world, seed=4) as server, line_client(server.settings) as client:
        client.begin(streams="tmp")
        client.until_lines("E4_Temperature", 6)
        readings = [line.values[0] for line in client.lines("E4_Temperature")]
    true = np.rint(wearer.skin_temperature_c(t) * 50) / 50
    assert set(np.round(readings, 4)) <= set(np.round(true, 4))
