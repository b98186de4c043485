"""Which process gets a stream, what it is started with, and what is told of one device."""

from __future__ import annotations

import sys
from pathlib import Path

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from lsl_to_ros.lsl.share import ALL, Share
from lsl_to_ros.parameters.node import fault
from lsl_to_ros.processes.child import Child, for_further
from lsl_to_ros.processes.mail import Setup
from lsl_to_ros.reports.reporting import merged
from tests.rigs.lsl_streams import wait_until


def info(name: str, source_id: str) -> pylsl.StreamInfo:
    return pylsl.StreamInfo(name, "EEG", 1, 100.0, "float32", source_id)


def owner(stream: pylsl.StreamInfo, of: int) -> int:
    (index,) = (index for index in range(of) if Share(index, of).has(stream))
    return index


def test_each_stream_has_one_process_and_none_has_far_too_many() -> None:
    streams = [info("any", f"zephyr-BHT{number}-ecg") for number in range(256)]
    for of in (1, 2, 3, 16):
        owners = [owner(stream, of) for stream in streams]
        counts = [owners.count(index) for index in range(of)]
        assert max(counts) < 2 * len(streams) / of
        assert min(counts) > 0.4 * len(streams) / of
    assert all(map(ALL.has, streams))


def test_the_source_decides_and_only_without_one_the_name() -> None:
    assert len({owner(info(f"name {number}", "one source"), 16) for number in range(40)}) == 1
    assert len({owner(info(f"name {number}", ""), 16) for number in range(40)}) > 8
    # Written down: Python's own hash would be another one in each process.
    assert [owner(info("any", f"source {number}"), 4) for number in range(8)] == FOUR


FOUR = [0, 1, 0, 2, 2, 0, 0, 3]

ROS = "--ros-args"


@pytest.mark.parametrize(
    ("given", "left"),
    [
        ((), []),
        ((ROS, "-p", "processes:=2", "--params-file", "x.yaml"), [ROS]),
        (
            (ROS, "--param", "a:=b", "-r", "c:=d", "--", "-p", "own"),
            [ROS, "-r", "c:=d", "--", "-p", "own"],
        ),
        ((ROS, "-r", "__node:=x", "--remap", "n:__ns:=/y", "-r", "a:=b"), [ROS, "-r", "a:=b"]),
        ((ROS, "-r", "n:a:=b", "-r", "other:a:=b"), [ROS, "-r", "a:=b", "-r", "other:a:=b"]),
        (
            (ROS, "--log-level", "debug", "--enclave", "/e"),
            [ROS, "--log-level", "debug", "--enclave", "/e"],
        ),
        (("-r", "not:=ros", ROS, "-p"), ["-r", "not:=ros", ROS]),
    ],
)
def test_parameters_and_names_are_not_handed_on(given: tuple[str, ...], left: list[str]) -> None:
    assert for_further(given, "n") == left


@pytest.mark.nightly
def test_a_process_that_cannot_be_started_is_told_and_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "executable", "/there/is/none")
    said: list[str] = []
    child = Child(Share(1, 2), _setup, lambda: None, said.append)
    facts = child.facts()
    assert (facts.is_gone, facts.pid) == (True, 0)
    assert facts.trouble.startswith("process 1 of 2 cannot be started (")
    assert "it is started again in" in facts.trouble
    assert len(said) == 1
    wait_until(child.look, "the second try")
    assert child.facts().restarts == 1
    assert len(said) == 2
    child.close()
    child.wait(0.0)


@pytest.mark.nightly
def test_only_time_in_which_the_first_process_runs_is_silence(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program = tmp_path / "says_nothing"
    program.write_text("#!/bin/sh\nexec sleep 60\n")
    program.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(program))
    # Not the time since this computer started: tenths of a second add up differently on each.
    now_s = 1000.0
    monkeypatch.setattr("lsl_to_ros.processes.child.monotonic", lambda: now_s)
    said: list[str] = []
    child = Child(Share(1, 2), _setup, lambda: None, said.append)
    pid = child.facts().pid
    # The computer stood still, and the other process with it.
    now_s += 1000.0
    assert not child.look()
    assert child.facts().trouble == ""
    for _ in range(300):
        now_s += 0.1
        assert not child.look()
    assert child.facts().trouble == "process 1 of 2 has said nothing for 30 s"
    assert child.facts().pid == pid
    for _ in range(21):
        now_s += 0.48
        child.look()
    wait_until(lambda: child.look() or said, "its end")
    (sentence,) = said
    assert sentence.startswith("process 1 of 2 said nothing for 40 s and was ended; ")
    child.close()
    child.wait(0.0)


def _setup(share: Share) -> Setup:
    return Setup(share, "lsl_to_ros", "/", [])


def entry(level: bytes, message: str, *values: str) -> DiagnosticStatus:
    pairs = [KeyValue(key=value, value=value) for value in values]
    return DiagnosticStatus(level=level, name="device x", message=message, values=pairs)


@pytest.mark.parametrize("value", [0, 17, -1, 2.0, "2", True, [2]])
def test_a_wrong_number_of_processes_has_a_sentence(value: object) -> None:
    sentence = f"processes must be a whole number from 1 to 16, not {value!r}"
    assert fault("processes", value) == sentence
    assert [fault("processes", right) for right in (1, 2, 16)] == [None] * 3


def test_a_device_in_two_processes_has_one_entry_with_all_values_and_the_worst_level() -> None:
    calm = entry(DiagnosticStatus.OK, "as its streams tell", "ecg", "acc")
    low = entry(DiagnosticStatus.WARN, "battery at 4 %", "battery")
    for statuses in ([calm, low], [low, calm]):
        (both,) = merged(statuses)
        assert (both.level, both.message) == (DiagnosticStatus.WARN, "battery at 4 %")
        assert {value.key for value in both.values} == {"ecg", "acc", "battery"}
    other = DiagnosticStatus(name="device y")
    assert [each.name for each in merged([calm, other, low])] == ["device x", "device y"]
