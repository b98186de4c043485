"""What a stream's entry in ``/diagnostics`` says, by what is known of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from biosensor_common.naming import TopicName
from lsl_to_ros.accounts.counters import Delays
from lsl_to_ros.lsl.discovery import Discovery
from lsl_to_ros.lsl.inlets import InletState
from lsl_to_ros.reports.diagnostics import (
    DOUBLED,
    LEASE_S,
    MAY_BE_DOUBLED,
    UNIX_STAMPS,
    StreamFacts,
    judge,
)


def facts(*, has_unix_stamps: bool = False, **told: Any) -> StreamFacts:
    """Return what is known of a stream of markers that is all right, but for what is told."""
    header = SimpleNamespace(rate=0.0, identity=SimpleNamespace(sensor="psychopy"))
    bridge: Any = SimpleNamespace(
        header=header, last_stamp=1.0, has_unix_stamps=has_unix_stamps, outputs=None
    )
    usual: dict[str, Any] = {
        **dict.fromkeys(("age_s", "rate", "correction_s", "spread_s", "silent_s"), 0.0),
        **dict.fromkeys(("attached_s", "published_hz", "waited_s"), 0.0),
        **dict.fromkeys(("lost_lately", "unfit_lately", "not_taken_lately"), 0),
        "delays": Delays(),
        "is_fast": False,
    }
    bridge.outputs = SimpleNamespace(chunk=None, timed=[])
    return StreamFacts(topic=TopicName("psychopy", "Markers"), bridge=bridge, **(usual | told))


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
JUDGED: list[tuple[StreamFacts, bytes, str]] = [
    (facts(), OK, "streaming"),
    (facts(twins=["lab-pc"]), ERROR, "that on lab-pc is not published: give each sender"),
    (facts(doubled_s=1.0), WARN, MAY_BE_DOUBLED),
    (facts(doubled_s=LEASE_S + 1), ERROR, DOUBLED),
    # The reason why nothing else fits comes first.
    (facts(has_unix_stamps=True, unfit_lately=3), WARN, UNIX_STAMPS),
]


@pytest.mark.parametrize(("told", "level", "words"), JUDGED)
def test_what_is_doubled_or_left_out_is_no_good_stream(
    told: StreamFacts, level: bytes, words: str
) -> None:
    judged, reason = judge(told)
    assert judged == level
    assert words in reason


class Info:
    """An outlet as the resolver reports it."""

    def __init__(self, uid: str, host: str) -> None:
        self._told = {"uid": uid, "hostname": host}

    def __getattr__(self, name: str) -> Callable[[], str]:
        usual = {"name": "MyMarkerStream", "type": "Markers", "source_id": "myuidw43536"}
        return lambda: (usual | self._told)[name]


class KnownInlet:
    """An inlet that opens at once and stays."""

    header, source_id, is_from_ros, is_delivering = None, "myuidw43536", False, False
    state = InletState.READY
    heard_s, waiting, is_served = math.inf, 0, True

    def __init__(self, described: Info, _warn: Callable[[str], None]) -> None:
        self.uid, self.info = described.uid(), described

    def continues_as(self, info: Info) -> bool:
        return info.source_id() == self.source_id

    def matches(self, _predicate: object) -> bool:
        return True

    def stop(self) -> None:
        """Nothing is open."""


def test_a_sender_that_is_left_out_is_known_until_it_is_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second, said, now = Info("1", "lab-pc"), Info("2", "stim-pc"), list[str](), [100.0]
    present = [first]
    module = "lsl_to_ros.lsl.discovery"

    def resolver(**_options: object) -> SimpleNamespace:
        return SimpleNamespace(results=lambda: present)

    monkeypatch.setattr(f"{module}.pylsl.ContinuousResolver", resolver)
    monkeypatch.setattr(f"{module}.Inlet", KnownInlet)
    monkeypatch.setattr(f"{module}.monotonic", lambda: now[0])
    discovery = Discovery(said.append)
    discovery.update()
    present.append(second)
    discovery.update()
    discovery.update()
    (served,) = discovery.inlets
    assert (served.uid, discovery.twins(served)) == ("2", [])
    # It still is there when a dead one would not be reported any more.
    now[0] += 10.0
    discovery.update()
    assert discovery.twins(served) == ["lab-pc"]
    assert len(said) == 1
    present.remove(first)
    discovery.update()
    assert discovery.twins(served) == []
