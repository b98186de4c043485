"""LabRecorder finds every stream with the configuration that the agent writes for it.

The real LabRecorder (liblsl 1.17) on a computer that has no network adapter, or no way
for multicast: without the file it misses streams, with the file it records them all.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import pytest
import pyxdf

from biosensor_common.lsl.api_file import home_config_file
from biosensor_gateway.recording.recorder.programs import LAB_RECORDER
from biosensor_gateway.recording.recorder.state import RecorderFolder
from biosensor_gateway.settings.places import SETTINGS_VARIABLE, STATE_VARIABLE
from tests.rigs.hosts.lan import NETWORK, Host, Lan
from tests.rigs.hosts.programs import Program
from tests.rigs.lab_recorder import PROGRAM

pytestmark = [pytest.mark.system, pytest.mark.timeout(400)]

OUTLETS = 60
RECORD_S = 6.0
# It looks for one second; on a busy machine not all of 60 answer in that time.
TRIES = 8
DEADLINE_S = 60.0
TRIES_WITHOUT = 2
_FOUND = re.compile(r"^Found (\S+)@", re.MULTILINE)
# Variables that name another configuration of LSL, or other settings of the agent.
_CHOSEN = {"LSLAPICFG", SETTINGS_VARIABLE, STATE_VARIABLE, "XDG_STATE_HOME"}
# Nothing but unicast gets in.
_NO_MULTICAST = """table inet office {
    chain arriving {
        type filter hook input priority 0
        meta pkttype { broadcast, multicast } drop
    }
}
"""

# What is not named, answered or local does not get in.
_FIREWALL = """table inet firewall {{
    chain arriving {{
        type filter hook input priority 0; policy drop
        iifname "lo" accept
        ct state established accept
        meta l4proto icmp accept
        udp dport {0} accept
        meta l4proto {{ tcp, udp }} th dport {1}-{2} accept
    }}
}}
"""
# What the agent and the node do before their first LSL call; then all streams are looked for.
_RESOLVE = """
import time
import pylsl
from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.lsl.network import configure_lsl

print(configure_lsl(LslOverrides()))
resolver = pylsl.ContinuousResolver(prop="type", value="Test", forget_after=60)
end = time.monotonic() + {deadline_s}
while len(resolver.results()) < {count} and time.monotonic() < end:
    time.sleep(0.1)
print(len(resolver.results()))
"""

_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


class User(NamedTuple):
    """Somebody on a computer, with a home folder of their own and no other configuration."""

    host: Host
    folder: Path

    @property
    def environment(self) -> dict[str, str]:
        inherited = {name: value for name, value in os.environ.items() if name not in _CHOSEN}
        return {**inherited, "HOME": str(self.folder)}

    @property
    def configuration(self) -> Path:
        return home_config_file(self.folder)

    def write_configuration(self, *options: str) -> str:
        """Call ``config lsl``; return what it said."""
        return self.run("-m", "biosensor_gateway.cli", "config", "lsl", *options)

    def run(self, *arguments: str) -> str:
        """Run Python to its end; return what it said."""
        command = self.host.command(sys.executable, *arguments)
        done = subprocess.run(
            command, env=self.environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout


@contextmanager
def outlets(user: User) -> Generator[Program]:
    """Run the outlets of a program that takes over the user's configuration, as the agent does."""
    program = Program(
        user.host, user.environment, user.folder, "tests.system.local_outlets", str(OUTLETS)
    )
    with program:
        deadline = time.monotonic() + DEADLINE_S
        while f"open: {OUTLETS}" not in program.log:
            assert time.monotonic() < deadline, program.last_words
            time.sleep(0.05)
        yield program


class Outcome(NamedTuple):
    """How many streams LabRecorder has found, and how many it has recorded samples of."""

    found: int
    recorded: int


ALL = Outcome(OUTLETS, OUTLETS)


def record(user: User, path: Path) -> Outcome:
    """Record whatever LabRecorder finds in the one second for which it looks."""
    log = path.with_suffix(".log")
    with log.open("wb") as output:
        recorder = subprocess.Popen(
            user.host.command(PROGRAM, str(path), "type='Test'"),
            env=user.environment,
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            time.sleep(RECORD_S)
            recorder.communicate(b"\n", DEADLINE_S)
        finally:
            recorder.kill()
            recorder.wait()
    found = len(set(_FOUND.findall(log.read_text())))
    if not path.exists():
        return Outcome(found, 0)
    streams, _ = _load_xdf(str(path))
    names = {stream["info"]["name"][0] for stream in streams if len(stream["time_stamps"])}
    return Outcome(found, len(names))


def record_often(user: User, path: Path, tries: int = TRIES) -> list[Outcome]:
    """Record again and again, until all streams are in one recording."""
    outcomes: list[Outcome] = []
    while len(outcomes) < tries and ALL not in outcomes:
        outcomes.append(record(user, path.with_suffix(f".{len(outcomes)}.xdf")))
    return outcomes


def show(what: str, outcomes: Sequence[Outcome]) -> None:
    print(f"{what}: " + ", ".join(f"{o.found} found, {o.recorded} recorded" for o in outcomes))


def at_work(host: Host, folder: Path) -> User:
    home = folder / host.name
    home.mkdir()
    return User(host, home)


def test_without_a_network_labrecorder_needs_the_file(tmp_path: Path) -> None:
    with Host("lab-pc") as host:
        user = at_work(host, tmp_path)
        with outlets(user):
            without = record_often(user, tmp_path / "without", TRIES_WITHOUT)
            said = user.write_configuration("--for", "single-pc")
            with_file = record_often(user, tmp_path / "with")
    show("lo only, without the file", without)
    show("lo only, with the file", with_file)
    assert str(user.configuration) in said
    # On a busy machine it may be too late for all of them once.
    assert all(outcome.found < OUTLETS for outcome in without)
    assert any(outcome.found for outcome in without)
    assert with_file[-1] == ALL


@pytest.mark.parametrize(
    "own", ["", "[multicast]\nResolveScope = machine\n", "[lab]\nKnownPeers = {10.9.9.9}\n"]
)
def test_without_a_network_our_recording_needs_no_file(own: str, tmp_path: Path) -> None:
    with Host("lab-pc") as host:
        user = at_work(host, tmp_path)
        if own:
            user.configuration.parent.mkdir(parents=True)
            user.configuration.write_text(own)
        command = ["-m", "biosensor_gateway.cli", "record"]
        with outlets(user):
            said = user.run(*command, "start", "--here", "--folder", str(tmp_path), "--json")
            saved = RecorderFolder(user.folder / ".local/state/biosensor-gateway").saved()
            user.run(*command, "stop")
    assert saved is not None
    assert (saved.recorder, len(json.loads(said)["streams"])) == (LAB_RECORDER, OUTLETS)


def test_the_file_does_no_harm_to_programs_that_take_it_over(tmp_path: Path) -> None:
    with Host("lab-pc") as host:
        user = at_work(host, tmp_path)
        user.write_configuration("--for", "single-pc")
        with outlets(user) as agent:
            recorded = record_often(user, tmp_path / "taken-over")
            resolved = user.run("-c", _RESOLVE.format(count=OUTLETS, deadline_s=DEADLINE_S))
            log = agent.log
    show("lo only, the agent with the file", recorded)
    assert f"taken over: {user.configuration}" in log
    assert recorded[-1] == ALL
    assert resolved.split() == [str(user.configuration), str(OUTLETS)]


def test_without_multicast_labrecorder_needs_the_file(tmp_path: Path) -> None:
    with Lan({"agent-pc": 0, "desk": 0}) as lan:
        for name in ("agent-pc", "desk"):
            lan[name].run("nft", "-f", "-", text=_NO_MULTICAST)
        desk, agent = at_work(lan["desk"], tmp_path), at_work(lan["agent-pc"], tmp_path)
        with outlets(agent):
            without = record_often(desk, tmp_path / "without", TRIES_WITHOUT)
            said = desk.write_configuration("--for", "two-pc", "--peer", f"{NETWORK}.1")
            with_file = record_often(desk, tmp_path / "with")
    show("no multicast, without the file", without)
    show("no multicast, with the file", with_file)
    assert "UDP 16571, and UDP and TCP 16572 to 16827" in said
    assert not any(outcome.found for outcome in without)
    assert with_file[-1] == ALL


def test_what_the_command_names_is_enough_for_the_firewalls(tmp_path: Path) -> None:
    with Lan({"agent-pc": 0, "desk": 0}) as lan:
        desk, agent = at_work(lan["desk"], tmp_path), at_work(lan["agent-pc"], tmp_path)
        said = desk.write_configuration("--for", "two-pc", "--peer", f"{NETWORK}.1")
        match = re.search(r"UDP (\d+), and UDP and TCP (\d+) to (\d+)", said)
        assert match is not None
        for name in ("agent-pc", "desk"):
            lan[name].run("nft", "-f", "-", text=_FIREWALL.format(*match.groups()))
        with outlets(agent):
            outcomes = record_often(desk, tmp_path / "recording")
    show("firewalls on both computers", outcomes)
    assert outcomes[-1] == ALL
