"""The LSL configuration in force; what the check says of it is compared with liblsl itself."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_common.doctor.check import Level
from biosensor_gateway.doctor.context import Context
from tests.doctor.conftest import above_ok, only

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

pytestmark = pytest.mark.nightly

Write = Callable[[str], Path]
Configured = Callable[[str], Context]


def session_of_liblsl() -> str:
    """The session that a program of the user is in, by liblsl's own reading."""
    code = (
        "import pylsl; o = pylsl.StreamOutlet(pylsl.StreamInfo('a', 'b', 1, 0, 'float32', 'c'));"
        "print(o.get_info().session_id())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_the_file_and_what_it_says(examine: Examine, context: Context, lsl_file: Write) -> None:
    path = lsl_file("[lab]\nSessionID = lab7\n[multicast]\nResolveScope = machine\n")
    found = examine(context, "lsl_config")
    assert only(found, f"LSL programs started here read {path}")
    assert only(
        found, "the agent's: session lab7; known peers none; scope machine; ports UDP 16571"
    )
    (note,) = above_ok(found)
    assert (note.level, "LSL session is lab7" in note.what) == (Level.NOTE, True)
    assert session_of_liblsl() == "lab7"


@pytest.mark.parametrize(
    "damage",
    ["# a comment", "SessionID", "SessionID = two\nSessionID = three", "\ufeff[lab]", "[lab"],
    ids=["hash", "no value", "twice", "byte order mark", "bracket"],
)
def test_a_file_that_liblsl_ignores_is_an_error(
    examine: Examine, context: Context, lsl_file: Write, damage: str
) -> None:
    text = "[lab]\nSessionID = lab7\n[multicast]\nResolveScope = machine\n[lab]\n"
    lsl_file(damage + "\n" + text if damage.startswith("\ufeff") else text + damage + "\n")
    (found,) = above_ok(examine(context, "lsl_config"))
    assert found.level is Level.ERROR
    assert "LSL ignores the whole file" in found.what
    assert str(Path(os.environ["LSLAPICFG"])) in found.fix


def test_liblsl_ignores_a_file_with_a_hash(lsl_file: Write) -> None:
    lsl_file("[lab]\nSessionID = lab7\n# a comment\n[multicast]\nResolveScope = machine\n")
    assert session_of_liblsl() == "default"


def test_another_session_than_labrecorder_s(
    examine: Examine, configured: Configured, lsl_file: Write
) -> None:
    lsl_file("[lab]\nSessionID = lab7\n")
    found = only(examine(configured('[lsl]\nsession_id = "lab8"\n'), "lsl_config"), "lab8, LSL")
    assert found.level is Level.WARNING
    assert "biosensor-gateway config lsl --force" in found.fix


def test_a_variable_that_names_nothing(
    examine: Examine, context: Context, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("LSLAPICFG", str(tmp_path / "gone.cfg"))
    found = above_ok(examine(context, "lsl_config"))
    assert [(each.level, "gone.cfg" in each.what) for each in found] == [(Level.WARNING, True)]


def test_files_that_are_not_read(
    examine: Examine,
    context: Context,
    lsl_file: Write,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    lsl_file("[lab]\nSessionID = default\n")
    home = tmp_path / "lsl_api" / "lsl_api.cfg"
    home.parent.mkdir()
    home.touch()
    monkeypatch.setenv("HOME", str(tmp_path))
    (found,) = above_ok(examine(context, "lsl_config"))
    assert found.what == f"LSL does not read {home}"


def test_a_peer_without_an_address(
    examine: Examine, configured: Configured, lsl_file: Write
) -> None:
    lsl_file("")
    context = configured('[lsl]\nknown_peers = ["127.0.0.1", "no-such-host.invalid"]\n')
    (found,) = above_ok(examine(context, "lsl_config"))
    assert "no-such-host.invalid" in found.what


def test_a_range_that_hides_streams(examine: Examine, context: Context, lsl_file: Write) -> None:
    lsl_file("[lab]\nKnownPeers = {127.0.0.1}\n")
    (found,) = above_ok(examine(context, "lsl_config"))
    assert found.what.startswith("PortRange is 32 ")
    lsl_file("[lab]\nKnownPeers = {127.0.0.1}\n[ports]\nPortRange = 256\n")
    assert not above_ok(examine(context, "lsl_config"))
