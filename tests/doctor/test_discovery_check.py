"""A stream of this computer is found here, from source and as a frozen program does it."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_common.doctor import probe as probes
from biosensor_common.doctor import streams
from biosensor_common.doctor.check import Level
from biosensor_common.doctor.probe import PROBE_COMMAND, Probe, ProbeError
from biosensor_common.lsl import api_file
from biosensor_gateway.doctor.context import Context
from tests.doctor.conftest import above_ok, only

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

pytestmark = pytest.mark.nightly

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


def test_a_frozen_program_is_its_own_other_process(
    examine: Examine, context: Context, session: str, frozen: Path
) -> None:
    del session
    assert probes.probe_command() == [str(frozen), PROBE_COMMAND]
    assert only(examine(context, "discovery"), "found here by unicast").level is Level.OK


def test_a_stream_that_is_not_found_is_an_error_with_the_ports(
    examine: Examine,
    context: Context,
    lsl_file: Callable[[str], Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lsl_file(CONFIG)
    real = streams.by_unicast
    away = {("ports", "BasePort"): "61000", ("ports", "PortRange"): "2"}

    # Who looks for it elsewhere does not find it, as behind a firewall.
    def elsewhere(config: str) -> str:
        return api_file.changed(real(config), away)

    monkeypatch.setattr(streams, "by_unicast", elsewhere)
    monkeypatch.setattr(streams, "OWN_SEARCH_S", 1.0)
    found = only(examine(context, "discovery"), "not even found")
    assert found.level is Level.ERROR
    for part in ("16571/udp", "16572:16827/tcp", "--add-port=16572-16827/udp"):
        assert part in found.fix


def test_a_process_that_ends_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    with Probe("no such role", 30.0, config=CONFIG) as probe, pytest.raises(ProbeError) as failed:
        probe.answer()
    assert "KeyError" in str(failed.value)
    command = [sys.executable, "-c", "import time; time.sleep(60)"]
    monkeypatch.setattr(probes, "probe_command", lambda: command)
    with Probe("find", 0.5, config=CONFIG) as probe, pytest.raises(ProbeError):
        probe.answer()


def test_what_is_offered_ends_with_who_asked_for_it() -> None:
    with Probe("offer", 30.0, config=CONFIG, source_id="doctor") as probe:
        assert probe.answer() == {"open": True}
        process = probe.process
    assert process.poll() is not None
