"""Where a refusal shows, and the ways in which each member is provoked."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

from biosensor_common.naming import TopicName
from biosensor_common.refusal import Refusal, Refusals
from biosensor_gateway.agent.status import RefusedStatus
from lsl_to_ros.reports.diagnostics import stream_facts, stream_status
from lsl_to_ros.reports.reporter import Part, concerns_of, node_status
from lsl_to_ros.statistics.status import LoadFacts, StreamStatus
from lsl_to_ros.topics.bridge import Bridge


class Shown(NamedTuple):
    """What a person sees: the level is that of ``/diagnostics``."""

    level: int
    text: str


Provoke = Callable[[pytest.MonkeyPatch], Shown]
PROVOKED: dict[Refusal, Provoke] = {}


def provokes(what: Refusal) -> Callable[[Provoke], Provoke]:
    """Register what provokes a member by real input."""

    def register(provoke: Provoke) -> Provoke:
        assert what not in PROVOKED
        PROVOKED[what] = provoke
        return provoke

    return register


def in_entry(bridge: Bridge) -> Shown:
    """What the entry of a stream in ``/diagnostics`` says."""
    topic = TopicName("biosensors/zephyr", bridge.header.data_name)
    facts = stream_facts(topic, bridge, StreamStatus(), 0.0, 0.0, bridge.last_stamp)
    status = stream_status(facts)
    return Shown(status.level[0], status.message)


def at_node(*books: Refusals, crowded_out: list[str] | None = None) -> Shown:
    """What the node's own entry says."""
    load = LoadFacts(0.1, 0.0, is_busy=False, is_late=False)
    part = Part(load, 1, 0, crowded_out or [], concerns_of(*books), [], [])
    status = node_status(part, {}, [])
    return Shown(status.level[0], status.message)


def in_status(refusals: Refusals) -> Shown:
    """What ``status`` and the page's JSON say of a stream, a device or the agent."""
    told = RefusedStatus.of(refusals)[0]
    assert told.now
    return Shown({"warn": 1, "error": 2}[told.level], told.sentence)


def fake(**told: Any) -> Any:
    """Return what has these attributes."""
    return SimpleNamespace(**told)
