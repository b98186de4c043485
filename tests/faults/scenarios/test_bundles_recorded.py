"""What comes in bundles of twelve seconds is recorded with its times, and is never green."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from biosensor_gateway.recording.xdf.verdict import Colour, check
from biosensor_gateway.simulation.faults import Untidiness
from tests.faults.agent import AgentProcess
from tests.faults.expectations import source
from tests.faults.matching import match
from tests.faults.scenarios.stage import is_streaming, lab_of, wait_until, write_settings
from tests.faults.scenarios.xdf import load
from tests.rigs.lab_recorder import LabRecorder

SENSOR, STAMPED = "polar_h10", ("ecg", "acc")
STREAMS = (*STAMPED, "hr", "ibi", "quality")
OF_THE_AGENT = "starts-with(source_id,'gateway-')"
BUNDLE_S, LASTS_S, SETTLE_S = 12.0, 30.0, 11.0
LIMIT_S = 0.05
"""On a computer that others use, too."""

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(240)]


def test_stamps_are_right_and_the_verdict_is_amber_with_what_happened(tmp_path: Path) -> None:
    file = tmp_path / "bundles.xdf"
    predicates = [f"source_id='{source(SENSOR, each)}'" for each in STREAMS] + [OF_THE_AGENT]
    with lab_of((SENSOR,), tmp_path) as lab:
        settings = write_settings(tmp_path, lab, {SENSOR: SENSOR})
        with AgentProcess(tmp_path, *settings, environment=lab.environment) as agent:
            wait_until(lambda: is_streaming(agent), "a device that streams")
            time.sleep(SETTLE_S)
            with LabRecorder(file, predicates, len(predicates)):
                time.sleep(SETTLE_S)
                lab.apply(SENSOR, Untidiness.BUNDLED.value, BUNDLE_S)
                wait_until(lambda: not is_streaming(agent), "an agent that misses its device")
                (status,) = agent.status().values()
                assert "no data of" in status["error"]
                time.sleep(LASTS_S)
                wait_until(lambda: is_streaming(agent), "a device that streams again")
                time.sleep(SETTLE_S)
            truth = lab.truth(SENSOR)
    # As it was stamped: pyxdf draws a line through what is regular.
    recorded = load(file, as_written=True)
    for each in STAMPED:
        received = recorded[source(SENSOR, each)]
        errors_s = received.times - truth[each].times[match(received, truth[each])]
        assert np.abs(errors_s).max() < LIMIT_S, each
    judged = check(file)
    assert judged.colour is Colour.AMBER
    found = {each.code: each.text for each in judged.findings}
    assert {"away", "silent"} <= found.keys()
    assert "not connected" in found["away"]
    assert "waited" in found["silent"]
