"""The node for two hours, with streams that stay and with streams that come and go.

Its memory is judged over the second hour: by then what fills for some minutes is full. Only by
``make faults LONG=1``; ``make bench`` does the same for ten minutes.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace

import pytest

from benchmarks import churn, staying
from benchmarks.effort import FULL, Effort
from benchmarks.figures import Measurement
from tests.faults.scenarios.figures import Record

_TWO_HOURS_S = 7200.0
SECONDS = min(_TWO_HOURS_S, float(os.environ.get("BIOSENSOR_GATEWAY_STEADY_S") or 0))
CERTAIN_MB_PER_H = 1.0
EFFORT = replace(
    FULL, staying_s=SECONDS, rotations=round(SECONDS / (churn.ROTATION * churn.PERIOD_S))
)

pytestmark = [
    pytest.mark.timeout(SECONDS * 1.5 + 300),
    pytest.mark.skipif(SECONDS == 0, reason="takes four hours: make faults LONG=1"),
]


@pytest.mark.parametrize("measure", [staying.measure, churn.measure], ids=["staying", "churn"])
def test_the_node_does_not_grow(measure: Callable[[Effort], Measurement], figures: Record) -> None:
    measured = measure(EFFORT)
    line = measured.details["slope_mb_per_h"]
    fault = f"{measured.title}, {SECONDS / 60:g} min"
    figures(fault, "memory slope of the node in the second half", "1 MB/h certain",
            f"{line['value']:+.2f} MB/h [{line['low']:+.2f}, {line['high']:+.2f}]")  # fmt: skip
    for figure in measured.figures:
        if figure.title.startswith("more "):
            figures(fault, f"{figure.title} of the node", "0", f"{figure.value:+g}")
    assert line["low"] <= CERTAIN_MB_PER_H
