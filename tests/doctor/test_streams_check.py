"""Streams that something is wrong with: outlets of another process, in a session of theirs."""

from __future__ import annotations

import os
import socket
import sys
import textwrap
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from biosensor_common.doctor import lsl_checks
from biosensor_common.doctor import probe as probes
from biosensor_common.doctor.check import Finding, Level
from biosensor_common.doctor.probe import PROBE_COMMAND, Probe, ProbeError, SurveyedStream
from biosensor_common.lsl import api_file
from biosensor_gateway.agent import status_file
from biosensor_gateway.doctor.context import Context
from tests.doctor.conftest import above_ok, only
from tests.doctor.outlets import Offered, arguments, running

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

# Streams of other sessions are seen, too, so those of another run must have other ids.
SAME, TWICE = (f"{word}-{uuid.uuid4().hex[:8]}" for word in ("same", "twice"))
GOOD = SurveyedStream("ecg", "id-1", "u1", "lab-pc", "float32", [16572], 0.001, 0.0004, 0.01)


def judged(*seen: SurveyedStream) -> list[Finding]:
    return above_ok(list(lsl_checks.judge(seen)))


@pytest.mark.nightly
def test_nothing_is_there(
    examine: Examine, context: Context, session: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    del session
    monkeypatch.setattr(lsl_checks, "SEARCH_S", 0.5)
    assert [each.what for each in examine(context, "streams")] == [
        "there is no LSL stream at the moment"
    ]


@pytest.mark.seam
def test_real_streams_with_real_mistakes(
    examine: Examine, context: Context, session: str, offer: Callable[..., None]
) -> None:
    del session
    offer(
        Offered("good", "good-1"),
        Offered("twin", "twin-1"),
        Offered("twin", "twin-2"),
        Offered("same-id-a", SAME),
        Offered("same-id-b", SAME),
        Offered("empty", ""),
        Offered("automatic", None),
        Offered("whole", "whole-1", format="int64"),
        Offered("unix", "unix-1", clock="unix"),
    )
    found = examine(context, "streams")
    (host,) = [each for each in found if each.level is Level.OK]
    print(host.what)
    assert host.what.startswith(f"9 streams on {socket.gethostname()}: clock offset ")
    bad = {each.what.split(":")[0].split(" (")[0]: each for each in above_ok(found)}
    # Other programs of this computer may have the low ports.
    bad = {what: each for what, each in bad.items() if each.level is not Level.NOTE}
    assert {what: each.level for what, each in bad.items()} == {
        "2 streams have the name twin": Level.WARNING,
        f"2 streams have the source_id {SAME}": Level.ERROR,
        "without a source_id": Level.WARNING,
        "with a source_id invented by pylsl": Level.WARNING,
        "in the format int64": Level.ERROR,
        f"unix on {socket.gethostname()}": Level.ERROR,
    }
    assert "same-id-a" in bad[f"2 streams have the source_id {SAME}"].what
    assert bad["without a source_id"].what.endswith(": empty")
    assert bad["with a source_id invented by pylsl"].what.endswith(": automatic")
    assert bad["in the format int64"].what.endswith(": whole")


@pytest.mark.seam
def test_a_source_id_is_in_another_session_too(
    examine: Examine, context: Context, session: str, offer: Callable[..., None]
) -> None:
    offer(Offered("own", TWICE), Offered("alone", "own-1"))
    elsewhere = arguments(f"{session}-b", [Offered("theirs", TWICE), Offered("other", "b-1")])
    with running([sys.executable, *elsewhere], os.environ):
        found = examine(context, "streams")
    bad = only(found, "another LSL session")
    assert bad.level is Level.ERROR
    assert f"also has the source_id {TWICE}: theirs on" in bad.what
    assert f"in session '{session}-b'" in bad.what


def test_each_source_id_of_another_session_is_an_error() -> None:
    theirs = replace(GOOD, session="b", name="theirs")
    found = list(lsl_checks.judge_elsewhere([theirs, replace(theirs, source_id="id-2")]))
    assert [each.level for each in found] == [Level.ERROR] * 2
    assert found[0].what == (
        "another LSL session also has the source_id id-1: theirs on lab-pc in session 'b'"
    )


@pytest.mark.nightly
def test_more_streams_than_lsl_asks_for(
    examine: Examine, context: Context, session: str, offer: Callable[..., None]
) -> None:
    del session
    offer(*(Offered(f"stream-{number}", f"id-{number}") for number in range(30)))
    found = examine(context, "streams")
    assert only(found, "round trip").what.startswith("30 streams on ")
    far = only(found, "on ports from 16604")
    assert far.level is Level.NOTE
    assert "biosensor-gateway config lsl" in far.fix


@pytest.mark.nightly
def test_what_the_agent_offers_and_nobody_sees(
    examine: Examine, context: Context, session: str
) -> None:
    del session
    device: dict[str, Any] = {"sensor": "zephyr", "streams": {"zephyr-1-ecg": {}}}
    status_file.write_status(
        context.state_folder, {"written": time.time() + 60, "process": 1, "devices": [device]}
    )
    found = only(examine(context, "streams"), "zephyr-1-ecg")
    assert found.level is Level.ERROR


@pytest.mark.nightly
def test_what_there_is_to_see_is_read_as_the_agent_reads_it(
    context: Context, session: str, offer: Callable[..., None]
) -> None:
    offer(Offered("a", session))
    (seen,), _ = lsl_checks.survey(context)
    assert (seen.name, seen.source_id, seen.format) == ("a", session, "float32")
    assert len(seen.ports) >= 2
    assert seen.offset_s is not None
    assert seen.stamp_error_s is not None
    # One computer, one clock.
    assert abs(seen.offset_s) < 0.1


def test_streams_without_a_mistake() -> None:
    assert not judged(GOOD, replace(GOOD, name="acc", source_id="id-2", uid="u2"))


@pytest.mark.parametrize(
    ("seen", "what"),
    [
        ((replace(GOOD, round_trip_s=0.25),), "round trip 250.00 ms"),
        ((replace(GOOD, offset_s=None, round_trip_s=None),), "does not give its time"),
        ((replace(GOOD, source_id="-4611686018427387904"),), "invented by pylsl"),
        ((replace(GOOD, stamp_error_s=-1.7e9),), "its timestamps are -1700000000 s off"),
    ],
)
def test_what_the_rules_say(seen: Sequence[SurveyedStream], what: str) -> None:
    (found,) = judged(*seen)
    assert what in found.what
    assert found.level in (Level.WARNING, Level.ERROR)


@pytest.mark.parametrize("serial", ["0123456789", "p01@zephyr-ecg", "00:06:66:AA:BB:CC-gsr"])
def test_ids_of_devices_are_not_taken_for_made_up_ones(serial: str) -> None:
    assert not judged(replace(GOOD, source_id=serial))


# A stream of this computer is found here, from source and as a frozen program does it.


CONFIG = "[multicast]\nResolveScope = machine\n[log]\nlevel = -2\n"
ROOT = Path(__file__).parents[2]


@pytest.fixture
def frozen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A program that is its own Python, as PyInstaller makes one."""
    program = tmp_path / "biosensor-gateway"
    program.write_text(
        textwrap.dedent(f"""\
            #!{sys.executable}
            import sys
            sys.path.insert(0, {str(ROOT)!r})
            from tests.doctor.conftest import program
            program()()
            """)
    )
    program.chmod(0o755)
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    monkeypatch.setattr(sys, "executable", str(program))
    return program


@pytest.mark.seam
def test_a_stream_is_found_by_unicast(examine: Examine, context: Context, session: str) -> None:
    del session
    found = examine(context, "discovery")
    assert only(found, "found here by unicast").level is Level.OK
    # The tests keep LSL on this computer.
    (note,) = above_ok(found)
    assert (note.level, "ResolveScope is machine" in note.what) == (Level.NOTE, True)


@pytest.mark.nightly
def test_a_frozen_program_is_its_own_other_process(
    examine: Examine, context: Context, session: str, frozen: Path
) -> None:
    del session
    assert probes.probe_command() == [str(frozen), PROBE_COMMAND]
    assert only(examine(context, "discovery"), "found here by unicast").level is Level.OK


@pytest.mark.nightly
def test_a_stream_that_is_not_found_is_an_error_with_the_ports(
    examine: Examine,
    context: Context,
    lsl_file: Callable[[str], Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lsl_file(CONFIG)
    real = lsl_checks.by_unicast
    away = {("ports", "BasePort"): "61000", ("ports", "PortRange"): "2"}

    # Who looks for it elsewhere does not find it, as behind a firewall.
    def elsewhere(config: str) -> str:
        return api_file.changed(real(config), away)

    monkeypatch.setattr(lsl_checks, "by_unicast", elsewhere)
    monkeypatch.setattr(lsl_checks, "OWN_SEARCH_S", 1.0)
    found = only(examine(context, "discovery"), "not found here even")
    assert found.level is Level.ERROR
    for part in ("16571/udp", "16572:16827/tcp", "--add-port=16572-16827/udp"):
        assert part in found.fix


@pytest.mark.nightly
def test_a_process_that_ends_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    with Probe("no such role", 30.0, config=CONFIG) as probe, pytest.raises(ProbeError) as failed:
        probe.answer()
    assert "KeyError" in str(failed.value)
    command = [sys.executable, "-c", "import time; time.sleep(60)"]
    monkeypatch.setattr(probes, "probe_command", lambda: command)
    with Probe("find", 0.5, config=CONFIG) as probe, pytest.raises(ProbeError):
        probe.answer()


@pytest.mark.nightly
def test_what_is_offered_ends_with_who_asked_for_it() -> None:
    with Probe("offer", 30.0, config=CONFIG, source_id="doctor") as probe:
        assert probe.answer() == {"open": True}
        process = probe.process
    assert process.poll() is not None
