"""Radios that fall silent, or send in bundles, while LabRecorder records."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.verdict import Colour, check
from biosensor_gateway.simulation.faults import FaultKind, Untidiness
from tests.faults.agent import AgentProcess
from tests.faults.expectations import source
from tests.faults.matching import Places, match
from tests.faults.recorder import Recorded
from tests.faults.scenarios.figures import Record
from tests.faults.scenarios.stage import is_streaming, lab_of, wait_until, write_settings
from tests.faults.scenarios.xdf import load
from tests.rigs.lab_client import Samples
from tests.rigs.lab_recorder import LabRecorder
from tests.rigs.processes import before_others
from tests.system.lab_recorder import recording

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(240)]

# Radios that fall silent for two seconds while LabRecorder records.

LIMIT_S = 0.005
# Virtual devices write when this computer lets them, and what it delays a clock takes for the
# device's own: after a break the first packets are all that it knows.
BUSY = 3
DROP_S = 2.0
# A clock is as good as it gets from the tenth second on.
SETTLE_S = 11.0
BEFORE_S, AFTER_S = 4.0, SETTLE_S + 4.0
STREAMS = {
    4: ("empatica_e4", "st"),
    64: ("empatica_e4", "bvp"),
    130: ("polar_h10", "ecg"),
    250: ("zephyr", "ecg"),
}
SENSORS = tuple(dict.fromkeys(name for name, _ in STREAMS.values()))
FAULT = "2 s radio drop-out, LabRecorder, pyxdf's defaults"


class Recording(NamedTuple):
    """One stream as it is in the file, and where each sample is in the device's truth."""

    received: Recorded
    as_written: Recorded
    truth: Samples
    places: Places

    @property
    def moved_s(self) -> float:
        """By how much a reader has moved a sample at most."""
        return float(np.abs(self.received.times - self.as_written.times).max())

    @property
    def errors_s(self) -> NDArray[np.float64]:
        """How far each sample is from when the device has measured it."""
        return np.abs(self.received.times - self.truth.times[self.places])

    @property
    def settled_errors_s(self) -> NDArray[np.float64]:
        """Those before the gap, and those from when the clock is as good behind it."""
        true_s = self.truth.times[self.places]
        last = int(np.argmax(np.diff(true_s)))
        is_settled = (true_s <= true_s[last]) | (true_s >= true_s[last + 1] + SETTLE_S)
        return self.errors_s[is_settled]

    @property
    def gap_s(self) -> float:
        return float(np.diff(self.truth.times[self.places]).max())


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Recording]:
    """What was recorded of the streams, by rate."""
    folder = tmp_path_factory.mktemp("dropouts")
    sources = [source(*stream) for stream in STREAMS.values()]
    with lab_of(SENSORS, folder) as lab:
        settings = write_settings(folder, lab, {name: name for name in SENSORS})
        with AgentProcess(folder, *settings, environment=lab.environment) as agent:
            # When it reads a line is when the line came.
            before_others(agent.pid)
            wait_until(lambda: is_streaming(agent), "streaming devices")
            time.sleep(SETTLE_S)
            with recording(folder / "dropout.xdf", sources):
                time.sleep(BEFORE_S)
                for name in SENSORS:
                    lab.apply(name, FaultKind.DROP.value, DROP_S)
                time.sleep(DROP_S)
                wait_until(lambda: is_streaming(agent), "devices that stream again")
                time.sleep(AFTER_S)
            truths = {name: lab.truth(name) for name in SENSORS}
    loaded = load(folder / "dropout.xdf")
    as_written = load(folder / "dropout.xdf", as_written=True)
    found: dict[int, Recording] = {}
    for rate, (name, data_name) in STREAMS.items():
        received, truth = loaded[source(name, data_name)], truths[name][data_name]
        written = as_written[source(name, data_name)]
        found[rate] = Recording(received, written, truth, match(received, truth))
    return found


@pytest.mark.parametrize("rate", STREAMS)
def test_a_gap_moves_no_other_sample(
    recordings: dict[int, Recording], rate: int, figures: Record
) -> None:
    found, (name, data_name) = recordings[rate], STREAMS[rate]
    # Behind the gap one line anchors the clock at first, and its delay is anybody's guess.
    worst_s = float(found.settled_errors_s.max())
    figures(
        FAULT,
        f"worst stamp error at {rate} Hz ({name}/{data_name})",
        f"< {1000 * LIMIT_S:g} ms",
        f"{1000 * worst_s:.2f} ms, right behind the gap {1000 * found.errors_s.max():.2f} ms, "
        f"of which pyxdf moved {1000 * found.moved_s:.2f} ms; gap of {found.gap_s:.1f} s",
    )
    assert found.gap_s >= DROP_S
    assert found.moved_s < LIMIT_S
    assert np.median(found.errors_s) < LIMIT_S
    assert worst_s < BUSY * LIMIT_S


# What comes in bundles of twelve seconds is recorded with its times, and is never green.
SENSOR, STAMPED = "polar_h10", ("ecg", "acc")
BUNDLED_STREAMS = (*STAMPED, "hr", "ibi", "quality")
OF_THE_AGENT = "starts-with(source_id,'gateway-')"
BUNDLE_S, LASTS_S, BUNDLED_SETTLE_S = 12.0, 30.0, 11.0
BUNDLED_LIMIT_S = 0.05
"""On a computer that others use, too."""


def test_stamps_are_right_and_the_verdict_is_amber_with_what_happened(tmp_path: Path) -> None:
    file = tmp_path / "bundles.xdf"
    predicates = [f"source_id='{source(SENSOR, each)}'" for each in BUNDLED_STREAMS] + [
        OF_THE_AGENT
    ]
    with lab_of((SENSOR,), tmp_path) as lab:
        settings = write_settings(tmp_path, lab, {SENSOR: SENSOR})
        with AgentProcess(tmp_path, *settings, environment=lab.environment) as agent:
            wait_until(lambda: is_streaming(agent), "a device that streams")
            time.sleep(BUNDLED_SETTLE_S)
            with LabRecorder(file, predicates, len(predicates)):
                time.sleep(BUNDLED_SETTLE_S)
                lab.apply(SENSOR, Untidiness.BUNDLED.value, BUNDLE_S)
                wait_until(lambda: not is_streaming(agent), "an agent that misses its device")
                (status,) = agent.status().values()
                assert "no data of" in status["error"]
                time.sleep(LASTS_S)
                wait_until(lambda: is_streaming(agent), "a device that streams again")
                time.sleep(BUNDLED_SETTLE_S)
            truth = lab.truth(SENSOR)
    # As it was stamped: pyxdf draws a line through what is regular.
    recorded = load(file, as_written=True)
    for each in STAMPED:
        received = recorded[source(SENSOR, each)]
        errors_s = received.times - truth[each].times[match(received, truth[each])]
        assert np.abs(errors_s).max() < BUNDLED_LIMIT_S, each
    judged = check(file)
    assert judged.colour is Colour.AMBER
    found = {each.code: each.text for each in judged.findings}
    assert {"away", "silent"} <= found.keys()
    assert "not connected" in found["away"]
    assert "data that came afterwards was delayed" in found["silent"]
