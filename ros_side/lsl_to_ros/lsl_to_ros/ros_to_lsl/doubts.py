"""Reports clocks of publishers that may be wrong, and anew when more is known of them."""

from __future__ import annotations

from collections.abc import Mapping

from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from lsl_to_ros.ros_to_lsl.publisher_clock import ClockState
from lsl_to_ros.ros_to_lsl.stamping import Doubt, StampSource, doubt_of

SAID_AGAIN_S = 1.0
"""Each loss and each change of channels is said: a recording of the events shall have it."""
_WHAT = {
    StampSource.HEADER: Refusal.DOUBTFUL_STAMPS,
    StampSource.SOURCE: Refusal.DOUBTFUL_CLOCK,
}


class Doubts:
    """What was said of the clocks of one topic."""

    def __init__(self, refusals: Refusals) -> None:
        self._refusals = refusals
        self._said: set[tuple[StampSource, ClockState]] = set()

    def tell(self, doubtful: Mapping[StampSource, Doubt]) -> None:
        """Report what is known now."""
        for source, what in _WHAT.items():
            doubt = doubtful.get(source)
            if doubt is None or (source, doubt.state) not in self._said:
                self._refusals.over(what)
            if doubt is not None:
                self._said.add((source, doubt.state))
                self._refusals.refuse(what, why=doubt_of(source, doubt))

    def restart(self) -> None:
        """Say everything anew: this computer's own clock has jumped."""
        self._said.clear()
