"""What answers say of the clock of who answered."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from lsl_to_ros.ros_to_lsl.application import Bounds
from lsl_to_ros.ros_to_lsl.stamps import Offset
from tests.ros_to_lsl.conftest import MILLISECOND, NOW_NS


def answer(sent_ms: float, came_ms: float) -> Any:
    return SimpleNamespace(
        source_timestamp=NOW_NS + round(sent_ms * MILLISECOND),
        received_timestamp=NOW_NS + round(came_ms * MILLISECOND),
    )


def test_answers_bound_a_clock_from_both_sides() -> None:
    bounds = Bounds()
    assert bounds.offset is None
    # Asked at 0, sent 4 ms later by a clock that is 500 ms behind.
    bounds.take(NOW_NS, answer(-496, 5))
    assert bounds.offset == Offset(-0.501, -0.496)
    bounds.take(NOW_NS, answer(-498, 20))
    assert bounds.offset == Offset(-0.501, -0.498)


def test_a_clock_that_was_set_in_between_is_not_measured() -> None:
    bounds = Bounds()
    bounds.take(NOW_NS, answer(-496, 5))
    bounds.take(NOW_NS, answer(4, 5))
    assert bounds.answers == 2
    assert bounds.offset is None


def test_an_answer_without_stamps_says_nothing() -> None:
    bounds = Bounds()
    silent: Any = SimpleNamespace(source_timestamp=0, received_timestamp=0)
    bounds.take(NOW_NS, silent)
    assert bounds.answers == 0
