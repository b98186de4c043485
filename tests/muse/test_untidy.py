"""Electrodes whose packets are missing or late, and a battery that is more than full."""

from __future__ import annotations

import random
from collections.abc import Iterable

import numpy as np
import pytest

from biosensor_gateway.devices.muse.driver.emitter import ClassicEmitter
from biosensor_gateway.devices.muse.driver.protocol import EEG, EEG_UV, PPG, TELEMETRY, Floats
from biosensor_gateway.system.device_log import DeviceLog
from tests.rigs.emitter_sink import EmitterSink

BEGIN_S = 1000.0
RATES = {"eeg": (EEG, 12, 256.0), "ppg": (PPG, 6, 64.0)}
Sent = tuple[float, str, bytes]


def packets(name: str, seconds: float = 60) -> Iterable[tuple[int, int, Sent]]:
    """Return packets with their number and channel; each value is its sample's number."""
    uuids, samples, rate_hz = RATES[name]
    for number in range(int(seconds * rate_hz / samples)):
        indices = range(number * samples, (number + 1) * samples)
        if name == "eeg":
            counts = [each % 4096 for each in indices]
            text = "".join(f"{each:03x}" for each in counts)
        else:
            text = "".join(f"{each:06x}" for each in indices)
        data = number.to_bytes(2, "big") + bytes.fromhex(text)
        for channel, uuid in enumerate(uuids):
            at_s = BEGIN_S + indices.stop / rate_hz + 0.001 * channel
            yield number, channel, (at_s, uuid, data)


def emitted(sent: Iterable[Sent]) -> EmitterSink:
    """Return what is emitted of packets."""
    sink = EmitterSink("muse")
    emitter = ClassicEmitter(sink, DeviceLog("test", sink.identity))
    emitter.started(has_aux=False)
    for at_s, uuid, data in sent:
        assert emitter.take(uuid, data, at_s)
    return sink


@pytest.mark.parametrize("name", ["eeg", "ppg"])
@pytest.mark.parametrize("times", [1, 3, 7])
def test_an_electrode_that_is_missing_some_times_doubles_no_rows(name: str, times: int) -> None:
    _, samples, _ = RATES[name]
    all_of = list(packets(name))
    last = len(RATES[name][0]) - 1
    missing = range(100, 100 + times)
    sink = emitted(each for n, channel, each in all_of if n not in missing or channel != last)
    rows = np.array(sink.emitted[name])
    count = len({n for n, _, _ in all_of}) * samples
    assert len(rows) == count
    assert not sink.losses.get(name)
    without = np.isnan(rows[:, last])
    # One more, where it came after nobody waited for it any longer.
    assert times * samples <= without.sum() <= (times + 1) * samples
    assert not np.isnan(rows[:, :last]).any()
    np.testing.assert_allclose(np.diff(sink.times[name]), 1 / RATES[name][2], rtol=0.02)


@pytest.mark.parametrize("seed", range(6))
def test_packets_that_are_lost_at_random_double_no_rows(seed: int) -> None:
    chance = random.Random(seed)
    came = [(n, each) for n, _, each in packets("eeg", 15) if chance.random() > 0.1 + seed / 25]
    sink = emitted(each for _, each in came)
    numbers = {n for n, _ in came}
    rows: Floats = np.array(sink.emitted["eeg"], np.float64)
    # The last one may still be waited for.
    assert len(rows) in (12 * len(numbers), 12 * len(numbers) - 12)
    values: Floats = np.nanmax(rows, axis=1)
    counts = np.round(values / EEG_UV) + 2048
    assert (np.diff(counts) > 0).all()
    assert sink.losses.get("eeg", 0) == counts[-1] - counts[0] + 1 - len(rows)
    errors_s = np.array(sink.times["eeg"]) - BEGIN_S - (counts + 1) / 256
    assert np.abs(errors_s).max() < 0.02


def test_a_packet_that_comes_twice_is_one() -> None:
    sent = [each for _, _, each in packets("eeg", 20) for _ in range(2)]
    sink = emitted(sent)
    assert len(sink.emitted["eeg"]) == len(sent) // 8 * 12
    assert not sink.losses.get("eeg")


@pytest.mark.parametrize(("told", "emitted_as"), [(90.5, 90.5), (100.0, 100), (100.5, 100)])
def test_a_full_battery_is_full(told: float, emitted_as: float) -> None:
    data = bytes(2) + round(told * 512).to_bytes(2, "big") + bytes(16)
    sink = emitted([(BEGIN_S, TELEMETRY, data)])
    assert sink.values("bat") == [emitted_as]
