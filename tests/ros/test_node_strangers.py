"""A robot gets heart rates of other programs that send in bursts, and no false alarm."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32, Float32MultiArray

from tests.features.test_senders_in_bursts import BURST, Sender, features_program, sending

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

RATES = {"ECG": 72.0, "PPG": 95.0}
FEWEST_BEATS, FEWEST_SAMPLES = 15, 20 * BURST


def _topic(ros: Ros, of: Sender, ending: str) -> str:
    """Wait for a topic of a feature; return its name."""

    def found() -> list[str]:
        return [each for each in ros.topics() if of.name in each and each.endswith(ending)]

    ros.until(lambda: bool(found()), f"{ending} of {of.name}")
    return found()[0]


def test_heart_rates_of_bursts_and_overlaps_reach_a_robot(
    ros: Ros, start_node: Callable[..., RunningNode], tmp_path: Path
) -> None:
    node = start_node()
    with ExitStack() as stack:
        stack.enter_context(features_program(tmp_path / "said.txt"))
        senders = [Sender(kind, 130.0, bpm, overlaps=kind == "PPG") for kind, bpm in RATES.items()]
        stack.enter_context(sending(*senders))
        raw = {
            each.name: f"/biosensors/{each.name}/{kind}"
            for each, kind in zip(senders, RATES, strict=True)
        }
        samples = {name: ros.listen(Float32MultiArray, topic) for name, topic in raw.items()}
        rates = {each.name: ros.listen(Float32, _topic(ros, each, "hr_live")) for each in senders}
        end = senders[0].truth[-1]
        warned: list[str] = []
        while pylsl.local_clock() < end:
            ros.report()
            for topic in raw.values():
                status = ros.status(topic)
                if status is not None and status.level != DiagnosticStatus.OK:
                    warned.append(f"{topic}: {status.message}")
        ros.spin(1.0)
    for sender, bpm in zip(senders, RATES.values(), strict=True):
        told = np.array([message.data for message in rates[sender.name]])
        assert len(told) >= FEWEST_BEATS, (sender.name, node.log)
        assert np.abs(told - bpm).max() < 8.0, sender.name
        assert len(samples[sender.name]) >= FEWEST_SAMPLES
    assert not warned
