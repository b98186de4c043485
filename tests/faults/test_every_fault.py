"""Each fault, for each sensor that it can hit: noticed, said, recovered from, counted.

All devices have a fault at the same time, and the agent is never started again. The
report ends with a table: sensor x fault x time to recover.
"""

from __future__ import annotations

import shutil
import sys

import numpy as np
import pytest

from biosensor_gateway.simulation.faults import OF_A_KIND, FaultKind
from tests.faults.bench import FaultBench
from tests.faults.expectations import (
    BREAKS,
    CELLS,
    MAY_BREAK,
    SENSORS,
    AgentFault,
    Kind,
    contact_of,
    is_by_agent,
    numeric_streams,
    regular_streams,
    unit_of,
    without_contact,
)

LONGEST_SENTENCE = 250
STAMP_LIMIT_S = 0.020
BACKLOG_STAMP_LIMIT_S = 0.5
"""A sleep takes 15 s: who stamps what is late by its arrival is wrong by that."""
SETTLED_S = 2.0
BEATS = frozenset({"ibi"})
"""Irregular streams whose samples have a moment of their own on the body."""

pytestmark = [
    pytest.mark.nightly,  # The first test of a kind lets it happen to all devices.
    pytest.mark.timeout(400),
    pytest.mark.skipif(
        sys.platform != "linux" or not shutil.which("dbus-daemon"),
        reason="a Linux with dbus-daemon is needed",
    ),
]
EVERY_CELL = pytest.mark.parametrize(
    ("kind", "name"), CELLS, ids=[f"{kind.value}-{name}" for kind, name in CELLS]
)
EVERY_SENSOR = pytest.mark.parametrize("name", SENSORS)
WORN = [name for name in SENSORS if (FaultKind.OFF_BODY, name) in CELLS]
"""Those that can tell whether somebody wears them."""


def test_the_devices_can_have_the_faults_of_the_matrix(bench: FaultBench) -> None:
    of_a_kind = {kind.value for kind in OF_A_KIND}
    assert {name: set(kinds) - of_a_kind for name, kinds in bench.lab.faults.items()} == {
        name: {kind.value for kind, hit in CELLS if hit == name and isinstance(kind, FaultKind)}
        for name in bench.sensors
    }


@EVERY_CELL
def test_it_is_noticed(bench: FaultBench, kind: Kind, name: str) -> None:
    assert (kind, name) in bench.episode(kind).seen


@EVERY_CELL
def test_it_is_said_in_one_sentence(bench: FaultBench, kind: Kind, name: str) -> None:
    warnings = bench.episode(kind).warnings(name)
    assert warnings or kind not in BREAKS | {FaultKind.FORGET, FaultKind.UNREADABLE}
    for record in warnings:
        assert record["unit"] == unit_of(name)
        assert record["level"] == "warning"
        assert "exception" not in record
        assert record["event"].isprintable()
        assert len(record["event"]) <= LONGEST_SENTENCE


@EVERY_CELL
def test_it_recovers_by_itself(bench: FaultBench, kind: Kind, name: str) -> None:
    episode = bench.episode(kind)
    assert (kind, name) in episode.recovered_s
    before, after = episode.before[name].status, episode.after[name].status
    assert (after["state"], after["error"]) == ("streaming", None)
    if kind not in MAY_BREAK:
        assert after["connections"] == before["connections"]


@EVERY_CELL
def test_what_is_lost_is_counted(bench: FaultBench, kind: Kind, name: str) -> None:
    assert not bench.episode(kind).imbalance(name)


@EVERY_CELL
def test_nothing_comes_twice_or_from_nowhere(bench: FaultBench, kind: Kind, name: str) -> None:
    episode = bench.episode(kind)
    for data_name in numeric_streams(name):
        assert (np.diff(episode.received[name, data_name].times) > 0).all(), data_name
        assert episode.counted(name, data_name, "refused") == 0, data_name
        if not is_by_agent(name, data_name) and (name, data_name) in episode.truth:
            episode.matched(name, data_name)


@pytest.mark.parametrize("name", WORN)
def test_without_contact_there_is_no_value(bench: FaultBench, name: str) -> None:
    episode = bench.episode(FaultKind.OFF_BODY)
    contact = contact_of(name)
    said = episode.received[name, contact.data_name]
    off_s = float(said.times[said.values[:, contact.channel] == contact.off][0])
    for data_name in without_contact(name):
        received = episode.received[name, data_name]
        values = received.since(off_s + SETTLED_S).until(episode.end_s[FaultKind.OFF_BODY, name])
        assert np.isnan(values.values).all(), data_name
        assert bool(len(values.times)) == (data_name in regular_streams(name)), data_name
        assert (received.values != 0).all(), data_name


@EVERY_SENSOR
def test_what_waited_for_an_agent_that_slept_is_stamped_as_measured(
    bench: FaultBench, name: str
) -> None:
    episode = bench.episode(AgentFault.ASLEEP)
    for data_name in regular_streams(name):
        places = episode.matched(name, data_name)
        measured_s = episode.truth[name, data_name].times[places]
        errors_s = episode.received[name, data_name].times - measured_s
        assert np.abs(errors_s).max() <= BACKLOG_STAMP_LIMIT_S, data_name


@EVERY_SENSOR
def test_beats_that_waited_are_where_the_heart_beat(bench: FaultBench, name: str) -> None:
    episode = bench.episode(AgentFault.ASLEEP)
    for data_name in BEATS & set(numeric_streams(name)):
        places = episode.matched(name, data_name)
        beaten_s = episode.truth[name, data_name].times[places]
        errors_s = episode.received[name, data_name].times - beaten_s
        assert len(errors_s), data_name
        assert np.abs(errors_s).max() <= BACKLOG_STAMP_LIMIT_S, data_name


@EVERY_SENSOR
def test_stamps_follow_a_oscillator_that_drifts(bench: FaultBench, name: str) -> None:
    episode = bench.episode(FaultKind.DRIFT)
    for data_name in regular_streams(name):
        places = episode.matched(name, data_name)
        measured_s = episode.truth[name, data_name].times[places]
        errors_s = episode.received[name, data_name].times - measured_s
        assert np.abs(errors_s).max() <= STAMP_LIMIT_S, data_name


def test_the_agent_was_never_started_again(bench: FaultBench) -> None:
    assert bench.agent.is_running
    assert "the driver failed" not in bench.agent.console()
