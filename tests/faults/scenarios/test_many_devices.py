"""Many devices of one model on one agent, and everybody can tell them apart."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from benchmarks.processes import Processes
from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.registry import declaration
from tests.faults.agent import fresh_status
from tests.faults.scenarios.figures import Record, is_long
from tests.faults.scenarios.ledger import TruthLedger
from tests.faults.scenarios.receiver import Received, read
from tests.faults.scenarios.stage import wait_until, write_settings
from tests.rigs.lab_client import LabProcess, Samples
from tests.system.programs import Program

# Twenty, read twice over, take all of two slow processors, and then the agent falls behind.
COUNT = 20 if is_long() else 10
MODEL = "shimmer3_gsr"
FAULT = f"{COUNT} devices of one model at once ({MODEL})"
KEYS = [f"unit{number:02}" for number in range(1, COUNT + 1)]
DATA_NAMES = [stream.data_name for stream in declaration(MODEL).streams]
REGULAR = [stream for stream in declaration(MODEL).streams if stream.rate != 0]
HOLD_S = 6.0
# So many connect, and a node attaches to a hundred streams.
DEADLINE_S = 120.0

# With others beside it, even so many would be too many.
pytestmark = [pytest.mark.alone, pytest.mark.timeout(360)]


class Crowd(NamedTuple):
    """What there was of all streams: outlets, topics by source_id, samples, truth, counters."""

    received: Received
    topics: Mapping[str, str]
    truth: Mapping[str, Samples]
    counters: Mapping[str, Mapping[str, Any]]


def source(key: str, data_name: str) -> str:
    return source_id(DeviceIdentity(MODEL, key.upper()), data_name)


def topics_of(listener: Program) -> dict[str, str]:
    """Raw topic of each stream of the model by source_id, as the node has said last."""
    lists = [record["message"] for record in listener.records]
    topics: dict[str, str] = {}
    for status in lists[-1]["status"] if lists else ():
        facts = {pair["key"]: pair["value"] for pair in status["values"]}
        if MODEL in facts["source_id"]:
            topics[facts["source_id"]] = status["name"]
    return topics


def truth_of(lab: LabProcess) -> dict[str, Samples]:
    truths = {key: lab.truth(key) for key in KEYS}
    return {source(key, name): each for key in KEYS for name, each in truths[key].items()}


def counters_of(state: Path) -> dict[str, dict[str, Any]]:
    devices = fresh_status(state)["devices"]
    return {key: counters for device in devices for key, counters in device["streams"].items()}


@pytest.fixture(scope="module")
def crowd(tmp_path_factory: pytest.TempPathFactory) -> Crowd:
    folder = tmp_path_factory.mktemp("many")
    devices = [
        {"key": key, "sensor": MODEL, "options": {"name": f"Shimmer3-{seed:04X}", "seed": seed}}
        for seed, key in enumerate(KEYS, 1)
    ]
    channels = {source(key, each.data_name): len(each.channels) for key in KEYS for each in REGULAR}
    awaited = {source(key, data_name) for key in KEYS for data_name in DATA_NAMES}
    # A hundred outlets take all ports that LSL has by default; so these have ports of their own.
    with LabProcess(devices, folder) as lab, Processes(folder) as processes, ExitStack() as stack:
        settings = write_settings(folder, lab, dict.fromkeys(KEYS, MODEL))
        processes.environment["BIOSENSOR_GATEWAY_STATE"] = str(folder)
        receiver = processes.start(
            "tests.faults.scenarios.receiver", str(folder / "received.npz"), json.dumps(channels)
        )
        node = processes.start_node()
        agent = processes.start("biosensor_gateway.cli", "run", *settings)
        heard = ["diagnostic_msgs/msg/DiagnosticArray@latched", "/lsl_to_ros/streams"]
        command = [sys.executable, "-m", "tests.system.listener", *heard]
        listener = Program(command, folder / "listener.txt", env=processes.environment)
        stack.callback(listener.end)
        receiver.expect("all", DEADLINE_S)
        wait_until(lambda: awaited <= topics_of(listener).keys(), "topics", DEADLINE_S)
        time.sleep(HOLD_S)
        topics, counters = topics_of(listener), counters_of(folder)
        receiver.wait()
        truth = truth_of(lab)
        node.stop()
        agent.stop()
    return Crowd(read(folder / "received.npz"), topics, truth, counters)


def test_their_names_are_distinct(crowd: Crowd, figures: Record) -> None:
    expected = COUNT * len(DATA_NAMES)
    names = [name for name in crowd.received.names.values() if MODEL in name]
    figures(FAULT, "distinct LSL names", str(expected), str(len(set(names))))
    assert len(names) == len(set(names)) == expected


def test_their_topics_are_distinct(crowd: Crowd, figures: Record) -> None:
    expected = COUNT * len(DATA_NAMES)
    figures(FAULT, "distinct topics", str(expected), str(len(set(crowd.topics.values()))))
    assert len(set(crowd.topics.values())) == expected
    for key in KEYS:
        folders = {crowd.topics[source(key, each)].rpartition("/")[0] for each in DATA_NAMES}
        assert len(folders) == 1, folders


def test_nothing_of_them_is_lost(crowd: Crowd, figures: Record) -> None:
    books = {each: TruthLedger() for each in crowd.received.recorded}
    for each, ledger in books.items():
        ledger.settle(crowd.received.recorded[each], crowd.truth[each])
        assert ledger.received, each
    received = sum(ledger.received for ledger in books.values())
    lost = sum(ledger.lost for ledger in books.values())
    figures(FAULT, "samples lost", "0", f"{lost} of {received:,} in {len(books)} streams")
    assert {each: ledger.lost for each, ledger in books.items() if ledger.lost} == {}
    assert {each: c for each, c in crowd.counters.items() if c["lost"] or c["refused"]} == {}
