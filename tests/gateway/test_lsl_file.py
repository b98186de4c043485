"""The configuration for LabRecorder: its text, and the command that writes it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.lsl.api_file import LslOverrides, effective_config
from biosensor_gateway.cli.config import LslFile, Ports, changes

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

Run = Callable[..., "Outcome"]

SINGLE = ("default", ("127.0.0.1",), 256)
OWN = """\
; mine
[tuning]
TimeProbeCount = 4

[lab]
KnownPeers = {10.0.0.5}
; the other one
[multicast]
ResolveScope = link
"""


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's folder, which is not the working folder; no file is named."""
    for name in ("home", "work"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.delenv("LSLAPICFG")
    return tmp_path / "home"


@pytest.fixture
def target(home: Path) -> Path:
    return home / "lsl_api" / "lsl_api.cfg"


def put(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode())


def adapted(text: str, wanted: tuple[str, tuple[str, ...], int] = SINGLE) -> LslFile:
    file = LslFile(text, "lsl_api.cfg")
    file.adapt(*wanted)
    return file


def lsl_s_opinion(path: Path) -> str:
    """What liblsl says of a file when it reads it."""
    program = "import pylsl; pylsl.StreamInfo('a', 'b', 1, 0, 'int8', 'c')"
    environment = os.environ | {"LSLAPICFG": str(path)}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stderr


def test_a_new_file_holds_what_labrecorder_needs_and_why() -> None:
    file = adapted("")
    lines = file.text.splitlines()
    for line in ("SessionID = default", "KnownPeers = {127.0.0.1}", "PortRange = 256"):
        assert line in lines
        assert lines[lines.index(line) - 1].startswith("; ")
    assert "Without a network adapter" in file.text
    assert file.ports == Ports(16571, 16572, 16827)


def test_a_file_for_two_computers_gives_their_reason() -> None:
    file = adapted("", ("lab2", ("10.0.0.5", "pc7"), 64))
    assert (file.session_id, file.known_peers) == ("lab2", ("10.0.0.5", "pc7"))
    assert file.ports == Ports(16571, 16572, 16635)
    assert "multicast may not get through" in file.text
    assert "Without a network adapter" not in file.text


@pytest.mark.nightly
def test_liblsl_reads_the_file(tmp_path: Path) -> None:
    for number, text in enumerate(("", OWN, OWN.replace("\n", "\r\n"), OWN.rstrip())):
        path = tmp_path / f"{number}.cfg"
        put(path, adapted(text).text)
        said = lsl_s_opinion(path)
        assert f"Configuration loaded from {path}" in said
        assert "rror" not in said


def test_all_else_in_a_file_stays() -> None:
    after = adapted(OWN).text
    gone = [line for line in changes(OWN, after) if line.startswith("-")]
    assert gone == ["- KnownPeers = {10.0.0.5}"]
    assert after.index("KnownPeers = {10.0.0.5, 127.0.0.1}") < after.index("; the other one")
    assert LslFile(after, "").session_id == "default"


def test_the_ends_of_lines_stay() -> None:
    after = adapted(OWN.replace("\n", "\r\n")).text
    assert after.count("\n") == after.count("\r\n") == adapted(OWN).text.count("\n")
    assert adapted(OWN.rstrip()).text == adapted(OWN).text


def test_adapting_again_changes_nothing() -> None:
    for text in ("", OWN, OWN.rstrip()):
        once = adapted(text).text
        assert adapted(once).text == once


def test_a_changed_setting_does_not_pile_up_comments() -> None:
    file = LslFile("", "lsl_api.cfg")
    for session in ("default", "lab2", "lab3"):
        file.adapt(session, ("127.0.0.1",), 256)
    assert file.text == adapted("", ("lab3", ("127.0.0.1",), 256)).text


def test_a_larger_range_of_ports_and_other_first_ports_stay() -> None:
    file = adapted("[ports]\nPortRange = 1000\nBasePort = 20000\nMulticastPort = 19999\n")
    assert file.ports == Ports(19999, 20000, 20999)


def test_peers_that_liblsl_would_overlook_are_put_right() -> None:
    assert "KnownPeers = {127.0.0.1}\n" in adapted("[lab]\nKnownPeers = 127.0.0.1\n").text


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("[lab]\n# mine\n", 2, "starts with ';'"),
        ("[lab\n", 1, "']'"),
        ("[lab]\n\nSessionID =\n", 3, "key = value"),
        ("[lab]\n ; mine\n", 2, "starts with ';'"),
        ("[lab]\nSessionID = a\n[lab]\nSessionID = b\n", 4, "second time"),
        ("\ufeff[lab]\n", 1, "byte order mark"),
    ],
)
def test_what_liblsl_cannot_read_is_named(text: str, line: int, words: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"^mine.cfg, line {line}: ") as raised:
        LslFile(text, "mine.cfg")
    assert raised.value.reason is ConfigReason.MALFORMED
    assert words in str(raised.value)
    put(tmp_path / "mine.cfg", text)
    assert "Configuration loaded" not in lsl_s_opinion(tmp_path / "mine.cfg")


def test_the_agent_and_the_node_take_over_what_is_written(tmp_path: Path) -> None:
    path = tmp_path / "lsl_api.cfg"
    put(path, adapted(OWN, ("lab2", ("127.0.0.1",), 512)).text)
    file = LslFile(effective_config(path, LslOverrides()), "effective")
    assert file.session_id == "lab2"
    assert file.known_peers == ("10.0.0.5", "127.0.0.1")
    assert file.ports.last == 16572 + 511
    other = LslFile(effective_config(path, LslOverrides("lab3", ("pc7",), 64)), "effective")
    assert (other.session_id, other.known_peers) == ("lab3", ("pc7",))
    assert other.ports.last == 16572 + 63


def test_the_command_writes_to_the_home_folder(run: Run, target: Path) -> None:
    outcome = run("config", "lsl")
    assert (outcome.code, outcome.err) == (0, "")
    assert f"wrote {target}" in outcome.out
    assert "Restart LabRecorder" in outcome.out
    assert "firewall" not in outcome.out
    assert target.read_text() == adapted("").text


def test_the_command_uses_the_user_s_settings(run: Run, target: Path, settings: Path) -> None:
    put(settings, '[lsl]\nsession_id = "lab2"\nport_range = 600\n')
    outcome = run("config", "lsl", "--for", "two-pc", "--peer", "pc7", "--peer", "10.0.0.5")
    assert outcome.code == 0
    file = LslFile(target.read_text(), str(target))
    assert (file.session_id, file.known_peers) == ("lab2", ("pc7", "10.0.0.5"))
    assert "LSL session: lab2" in outcome.out
    assert "of pc7, 10.0.0.5 must allow incoming UDP 16571" in outcome.out
    assert "UDP and TCP 16572 to 17171" in outcome.out


def test_the_environment_goes_before_settings_that_are_not_there(
    run: Run, target: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__SESSION_ID", "lab2")
    assert run("config", "lsl").code == 0
    assert LslFile(target.read_text(), "").session_id == "lab2"
    monkeypatch.setenv("BIOSENSOR_GATEWAY_LSL__PORT_RANGE", "many")
    outcome = run("config", "lsl")
    assert outcome.code == 2
    assert "BIOSENSOR_GATEWAY_LSL__PORT_RANGE" in outcome.err


def test_wrong_or_missing_settings_are_refused(run: Run, target: Path, settings: Path) -> None:
    outcome = run("config", "lsl", "--settings", "other.toml")
    assert outcome.code == 2
    assert "other.toml" in outcome.err
    put(settings, "[lsl]\nsession_id = 5\n")
    outcome = run("config", "lsl")
    assert outcome.code == 2
    assert "session_id" in outcome.err
    assert not target.exists()


@pytest.mark.parametrize(
    "arguments", [("--for", "two-pc"), ("--peer", "a b"), ("--peer", "a}"), ("--for", "three")]
)
def test_wrong_options_are_refused(run: Run, target: Path, arguments: tuple[str, ...]) -> None:
    assert run("config", "lsl", *arguments).code == 2
    assert not target.exists()


def test_a_session_that_the_agent_takes_over_is_kept(run: Run, target: Path) -> None:
    put(target, "[lab]\nSessionID = mine\n")
    assert "LSL session: mine" in run("config", "lsl", "--force").out
    assert LslFile(target.read_text(), "").session_id == "mine"


def test_a_file_is_changed_only_by_force_and_never_lost(run: Run, target: Path) -> None:
    put(target, OWN)
    outcome = run("config", "lsl")
    assert outcome.code == 2
    assert "--force" in outcome.err
    assert outcome.err.count("\n") == 1
    assert "  - KnownPeers = {10.0.0.5}\n" in outcome.out
    assert "  + KnownPeers = {10.0.0.5, 127.0.0.1}\n" in outcome.out
    assert [path.name for path in target.parent.iterdir()] == ["lsl_api.cfg"]
    assert target.read_text() == OWN

    assert "lsl_api.cfg.bak\n" in run("config", "lsl", "--force").out
    first = target.read_text()
    assert first == adapted(OWN).text
    run("config", "lsl", "--peer", "pc7", "--force")
    run("config", "lsl", "--peer", "pc8", "--force")
    copies = {path.name: path.read_text() for path in target.parent.iterdir()}
    assert copies.keys() == {"lsl_api.cfg", *(f"lsl_api.cfg.bak{n}" for n in ("", "2", "3"))}
    assert copies["lsl_api.cfg.bak"] == OWN
    assert copies["lsl_api.cfg.bak2"] == first


def test_a_file_that_holds_all_stays_as_it_is(run: Run, target: Path) -> None:
    run("config", "lsl")
    before = target.stat().st_mtime_ns, target.stat().st_ino
    outcome = run("config", "lsl")
    assert outcome.code == 0
    assert "nothing was changed" in outcome.out
    assert (target.stat().st_mtime_ns, target.stat().st_ino) == before


def test_bytes_that_are_no_utf_8_stay(run: Run, target: Path) -> None:
    target.parent.mkdir()
    target.write_bytes(b"; f\xfcr mich\n[lab]\nSessionID = mine\n")
    assert run("config", "lsl", "--force").code == 0
    assert target.read_bytes().startswith(b"; f\xfcr mich\n[lab]\nSessionID = mine\n")


def test_a_file_that_goes_before_it_is_named(
    run: Run, target: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, named = tmp_path / "work" / "lsl_api.cfg", tmp_path / "named.cfg"
    put(here, "[lab]\nSessionID = here\n")
    put(named, "[lab]\nSessionID = named\n")
    assert f"warning: {here} takes precedence over it" in run("config", "lsl").err
    monkeypatch.setenv("LSLAPICFG", str(named))
    outcome = run("config", "lsl", "--force")
    assert outcome.code == 0
    assert (
        f"{named} takes precedence over it, because the environment variable LSLAPICFG"
        in outcome.err
    )
    # The agent takes over the first file, whatever is in that which is written.
    assert LslFile(target.read_text(), "").session_id == "named"


def test_a_place_where_lsl_does_not_look_is_named(run: Run, home: Path) -> None:
    path = home / "elsewhere" / "lab.cfg"
    outcome = run("config", "lsl", "--out", str(path))
    assert path.is_file()
    assert f"set the environment variable LSLAPICFG to {path}" in outcome.err


@pytest.mark.parametrize("place", ["folder", "file/lsl_api.cfg"])
def test_a_place_that_cannot_be_written_is_one_sentence(run: Run, home: Path, place: str) -> None:
    (home / "folder").mkdir()
    (home / "file").write_text("")
    outcome = run("config", "lsl", "--out", str(home / place))
    assert outcome.code == 2
    assert str(home) in outcome.err
    assert outcome.err.count("\n") == 1
