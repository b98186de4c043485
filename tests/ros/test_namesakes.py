"""Live senders that claim to be one stream: who is served, and under which number."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import permutations
from types import SimpleNamespace
from typing import Any

import pytest

from biosensor_common.refusal import Refusal, Refusals
from lsl_to_ros.lsl.discovery import ALIVE_AFTER_S, SETTLED_S, Discovery
from lsl_to_ros.lsl.inlets import InletState


class Info:
    """An outlet as the resolver reports it."""

    def __init__(self, uid: str, host: str, started_s: float, kind: int = 3) -> None:
        self._told = {
            "name": "MyMarkerStream",
            "type": "Markers",
            "source_id": "myuidw43536",
            "channel_count": 1,
            "nominal_srate": 0.0,
            "uid": uid,
            "hostname": host,
            "created_at": started_s,
            "channel_format": kind,
        }

    def __getattr__(self, name: str) -> Callable[[], Any]:
        return lambda: self._told[name]


class KnownInlet:
    """An inlet that opens at once, and ends when a test says so."""

    source_id, is_from_ros, is_delivering = "myuidw43536", False, False
    heard_s, waiting, is_served = math.inf, 0, True
    is_foreign = True

    def __init__(self, described: Any, _refusals: Refusals, number: int = 1) -> None:
        self.uid, self.info, self.number = described.uid(), described, number
        self.state = InletState.READY
        self.header = SimpleNamespace(foreign=self.is_foreign)

    def continues_as(self, info: Info) -> bool:
        return info.source_id() == self.source_id

    def matches(self, _predicate: object) -> bool:
        return True

    def stop(self) -> None:
        """Nothing is open."""


class Lab:
    """Outlets that come and go, and a node that looks for them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.present: list[Info] = []
        self.said: list[str] = []
        self.now_s = 100.0
        module = "lsl_to_ros.lsl.discovery"

        def resolver(**_options: object) -> SimpleNamespace:
            return SimpleNamespace(results=lambda: self.present)

        monkeypatch.setattr(f"{module}.pylsl.ContinuousResolver", resolver)
        monkeypatch.setattr(f"{module}.Inlet", KnownInlet)
        monkeypatch.setattr(f"{module}.monotonic", lambda: self.now_s)
        self.start()

    def start(self) -> None:
        """Start the node, again."""
        self.discovery = Discovery(self.said.append)

    def look(self, *present: Info, after_s: float = 0.0) -> dict[str, int]:
        """Let the node look; return the numbers of those that it serves."""
        self.now_s += after_s
        self.present[:] = present
        for _ in present:
            self.discovery.update()
            self.now_s += SETTLED_S
        self.discovery.update()
        return {inlet.uid: inlet.number for inlet in self.discovery.inlets}

    def end(self, uid: str) -> None:
        """Let an outlet end; the resolver may still report it."""
        for inlet in self.discovery.inlets:
            if inlet.uid == uid:
                inlet.state = InletState.LOST


@pytest.fixture
def lab(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    yield Lab(monkeypatch)
    KnownInlet.is_foreign = True


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_each_sender_of_another_program_has_a_number_of_its_own(
    lab: Lab, order: tuple[int, ...]
) -> None:
    senders = [Info("c", "lab-pc", 1.0), Info("b", "stim-pc", 2.0), Info("a", "stim-pc", 2.5, 1)]
    assert lab.look(*(senders[place] for place in order)) == {"c": 1, "b": 2, "a": 3}
    first = lab.discovery.inlets[0]
    assert lab.discovery.senders(first) == ["lab-pc", "stim-pc", "stim-pc"]
    assert lab.discovery.twins(first) == []
    # And the same ones if the node starts again.
    lab.start()
    assert lab.look(*senders) == {"c": 1, "b": 2, "a": 3}


def test_a_sender_that_starts_again_gets_its_number_back(lab: Lab) -> None:
    first, second = Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0)
    assert lab.look(first) == {"1": 1}
    assert lab.look(first, second) == {"1": 1, "2": 2}
    lab.end("1")
    # The old outlet is reported for some seconds more, and must not be taken for a third one.
    again = Info("3", "lab-pc", 3.0)
    assert lab.look(first, second, again) == {"2": 2, "3": 1}
    assert lab.look(second, again, after_s=10.0) == {"2": 2, "3": 1}
    lab.end("2")
    assert lab.look(again) == {"3": 1}
    assert lab.discovery.senders(lab.discovery.inlets[0]) == []


def test_one_sender_that_moves_keeps_its_name(lab: Lab) -> None:
    assert lab.look(Info("1", "lab-pc", 1.0)) == {"1": 1}
    lab.end("1")
    assert lab.look(Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0)) == {"2": 1}


def test_a_second_sender_of_one_device_is_left_out_and_known(lab: Lab) -> None:
    KnownInlet.is_foreign = False
    first, second = Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0)
    lab.look(first)
    assert lab.look(first, second) == {"2": 1}
    (served,) = lab.discovery.inlets
    assert lab.discovery.twins(served) == []
    # It still is there when a dead one would not be reported any more.
    assert lab.look(first, second, after_s=ALIVE_AFTER_S + 1) == {"2": 1}
    assert lab.discovery.twins(served) == ["lab-pc"]
    (told,) = lab.discovery.refusals.present
    assert told.what is Refusal.SAME_SOURCE
    assert len(lab.said) == 1
    lab.look(second)
    assert lab.discovery.twins(served) == []
    assert lab.discovery.refusals.present == []
