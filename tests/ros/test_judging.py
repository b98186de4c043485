"""What a stream's entry in ``/diagnostics`` says, by what is known of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from biosensor_common.naming import TopicName
from biosensor_common.refusal import Refusal, Refusals
from lsl_to_ros.reports.diagnostics import LEASE_S, StreamFacts, judge
from lsl_to_ros.statistics.losses import Delays


def facts(*, has_unix_stamps: bool = False, unfit: int = 0, **told: Any) -> StreamFacts:
    """Return what is known of a stream of markers that is all right, but for what is told."""
    header = SimpleNamespace(rate=0.0, identity=SimpleNamespace(sensor="psychopy"))
    bridge: Any = SimpleNamespace(header=header, last_stamp=1.0, has_unix_stamps=has_unix_stamps)
    refusals = Refusals()
    if unfit:
        refusals.refuse(Refusal.UNFIT, unfit, why="it is too large")
    usual: dict[str, Any] = {
        **dict.fromkeys(("age_s", "rate", "correction_s", "spread_s", "silent_s"), 0.0),
        **dict.fromkeys(("attached_s", "published_hz", "waited_s"), 0.0),
        **dict.fromkeys(("lost_lately", "not_taken_lately"), 0),
        "delays": Delays(),
        "is_fast": False,
        "refused": refusals.present,
        "topic": TopicName("psychopy", "Markers"),
    }
    bridge.outputs = SimpleNamespace(chunk=None, timed=[])
    return StreamFacts(bridge=bridge, **(usual | told))


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
UNIX = Refusal.UNIX_STAMPS.told()
SHARED, CLAIMED = (
    TopicName("psychopy", "Markers", conflict=True),
    TopicName("psychopy", "Markers", duplicate=True),
)
DELAYED = Delays(total=4000.0, count=1, longest=4000.0)
JUDGED: list[tuple[StreamFacts, bytes, str]] = [
    (facts(), OK, "streaming"),
    (facts(topic=SHARED), ERROR, "two units of one sensor: give each a label"),
    (facts(topic=CLAIMED), ERROR, "two streams claim to be this one"),
    (facts(twins=["lab-pc"]), ERROR, "that on lab-pc is not published: give each sender"),
    (facts(senders=["a", "b"]), WARN, "2 senders have the same source_id, name and type, on a, b"),
    (facts(doubled_s=1.0), WARN, Refusal.MAYBE_DOUBLED.told()),
    (facts(doubled_s=LEASE_S + 1), ERROR, Refusal.DOUBLED.told()),
    (facts(delays=DELAYED), WARN, "its stamps are not times of the LSL clock"),
    (facts(correction_s=None, attached_s=60.0), WARN, "the sender's clock cannot be asked"),
    (facts(unfit=3), WARN, "3 samples were not published: it is too large"),
    # None hides another one.
    (facts(has_unix_stamps=True, unfit=1), WARN, f"{UNIX}; 1 sample was not published"),
]


@pytest.mark.parametrize(("told", "level", "words"), JUDGED)
def test_what_is_doubled_or_left_out_is_no_good_stream(
    told: StreamFacts, level: bytes, words: str
) -> None:
    judged, reason = judge(told)
    assert judged == level
    assert words in reason
