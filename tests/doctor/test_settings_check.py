"""Checks of this computer's settings: the file, the ports, the configuration of LSL, versions."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pylsl
import pytest
from pylsl.lib import lib

from biosensor_common.doctor.check import Level
from biosensor_common.doctor.probe import Probe
from biosensor_gateway.agent import status_file
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.doctor.context import Context, read_context
from tests.doctor.conftest import POLAR, ZEPHYR, above_ok, only
from tests.doctor.outlets import Offered

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

pytestmark = pytest.mark.nightly

# The settings file, the state folder and the running agent.

DEADLINE_S = 30.0


def test_no_file_is_a_note_with_the_command(examine: Examine, tmp_path: Path) -> None:
    found = examine(read_context(tmp_path / "none.toml", tmp_path), "settings")
    missing = only(found, "no settings file")
    assert missing.level is Level.NOTE
    assert "biosensor-gateway config init" in missing.fix


def test_every_mistake_is_an_error_with_its_line(
    examine: Examine, configured: Callable[[str], Context]
) -> None:
    broken = configured('[lsl]\nsession = "x"\n[[device]]\nsensor = "polar_h11"\nunit = "1"\n')
    errors = above_ok(examine(broken, "settings"))
    assert [each.level for each in errors] == [Level.ERROR] * 2
    assert "settings.toml:2:" in errors[0].what or "line 2" in errors[0].what
    assert "polar_h10" in errors[1].what


def test_no_device_and_none_enabled_are_warnings(
    examine: Examine, configured: Callable[[str], Context]
) -> None:
    (without,) = above_ok(examine(configured(""), "settings"))
    assert (without.level, "no device is described" in without.what) == (Level.WARNING, True)
    (disabled,) = above_ok(examine(configured(POLAR + "enabled = false\n"), "settings"))
    assert (disabled.level, "no device is enabled" in disabled.what) == (Level.WARNING, True)


def test_good_settings_are_shown(examine: Examine, configured: Callable[[str], Context]) -> None:
    found = examine(configured(POLAR), "settings")
    assert not above_ok(found)
    assert "1 of 1 devices enabled: polar_h10 1" in found[0].what
    assert only(found, "no agent runs")


def test_a_driver_that_is_damaged_is_an_error(examine: Examine, context: Context) -> None:
    damaged = replace(context, problem=ImportError("no module named bleak"))
    found = only(examine(damaged, "settings"), "bleak")
    assert found.level is Level.ERROR


def test_a_state_folder_that_is_none(examine: Examine, context: Context, tmp_path: Path) -> None:
    file = tmp_path / "a file"
    file.touch()
    found = only(examine(replace(context, state_folder=file / "state"), "settings"), "state folder")
    assert found.level is Level.ERROR
    assert str(file) in found.fix


def test_looking_makes_nothing(examine: Examine, context: Context) -> None:
    found = examine(context, "settings")
    assert not above_ok(found)[1:]
    assert only(found, "state folder").what.endswith(", can be made")
    assert not context.state_folder.exists()
    context.state_folder.mkdir(parents=True)
    assert only(examine(context, "settings"), "state folder").what.endswith(", writable")


def test_streams_are_counted_that_the_agent_would_open(
    configured: Callable[[str], Context],
) -> None:
    assert configured("").streams_to_open == 0
    one, both = configured(POLAR), configured(POLAR + ZEPHYR.format("COM3"))
    of_polar, of_zephyr = (len(declaration(each).streams) for each in ("polar_h10", "zephyr"))
    # Those of no sensor are the same, however many sensors there are.
    assert one.streams_to_open > of_polar
    assert both.streams_to_open - one.streams_to_open == of_zephyr
    assert configured(POLAR + "enabled = false\n").streams_to_open == 0


def test_a_running_agent_is_shown(
    examine: Examine, configured: Callable[[str], Context], tmp_path: Path
) -> None:
    context = configured("")
    command = [sys.executable, "-m", "biosensor_gateway.cli", "run"]
    environment = os.environ | {
        "BIOSENSOR_GATEWAY_STATE": str(context.state_folder),
        "BIOSENSOR_GATEWAY_SETTINGS": str(context.settings_path),
    }
    with (tmp_path / "log").open("wb") as log:
        agent = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
    try:
        deadline = time.monotonic() + DEADLINE_S
        while not (context.state_folder / status_file.STATUS_FILE).exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert only(examine(context, "settings"), f"an agent runs (process {agent.pid})")
        agent.send_signal(signal.SIGSTOP)
        (context.state_folder / status_file.STATUS_FILE).write_text("{}")
        stuck = only(examine(context, "settings"), "does not report")
        assert stuck.level is Level.WARNING
    finally:
        agent.send_signal(signal.SIGCONT)
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) is not None


# Versions and places, and libraries that are missing.
def test_what_runs_here(examine: Examine, context: Context) -> None:
    found = examine(context, "versions")
    assert not above_ok(found)
    assert only(found, f"Python {sys.version.split()[0]}, {sys.executable}")
    liblsl = only(found, f"), {lib._name}").what
    for detail in pylsl.library_info().split("/build:")[0].split("/branch:"):
        assert detail in liblsl
    # Else a terminal breaks a word; a path stays whole, so that it can be copied.
    words = [word for each in found for word in each.what.split() if "site-packages" not in word]
    assert max(map(len, words)) <= 68, words
    for name in ("biosensor-gateway ", "pylsl ", "bleak ", "numpy "):
        assert [each for each in found if each.what.startswith(name)]


def test_a_computer_without_liblsl(
    examine: Examine, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)
    found = only(examine(context, "versions"), "pylsl cannot be used")
    assert found.level is Level.ERROR
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    arm = only(examine(context, "versions"), "pylsl cannot be used")
    assert "https://github.com/sccn/liblsl/releases" in arm.fix
    for name in ("discovery", "streams"):
        not_searched = only(examine(context, name), "no stream was searched for")
        assert (not_searched.level, not_searched.fix) == (Level.WARNING, arm.fix)


def test_an_old_liblsl(examine: Examine, context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pylsl, "library_version", lambda: 116)
    found = only(examine(context, "versions"), "is too old")
    assert found.level is Level.ERROR


def test_a_library_that_is_missing(
    examine: Examine, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "bleak", None)
    found = only(examine(context, "versions"), "bleak cannot be used")
    assert (found.level, found.fix.endswith(" bleak")) == (Level.ERROR, True)


# The ports of LSL, some of them really held.
TCP, UDP = socket.SOCK_STREAM, socket.SOCK_DGRAM
COUNT = 40
Hold = Callable[[socket.SocketKind, int], None]


@pytest.fixture
def hold() -> Generator[Hold]:
    with ExitStack() as stack:

        def bind(kind: socket.SocketKind, port: int) -> None:
            holder = stack.enter_context(socket.socket(socket.AF_INET, kind))
            holder.bind(("", port))
            if kind is TCP:
                holder.listen()

        yield bind


@pytest.fixture
def ports(lsl_file: Callable[[str], Path]) -> range:
    """Ports that nobody has, as those of LSL; discovery is on the one before them."""
    for first in range(30001, 60000, 101):
        attempt = range(first, first + COUNT)
        if all(_is_free(port) for port in range(first - 1, first + COUNT)):
            # The settings' own range has priority.
            lsl_file(
                f"[ports]\nBasePort = {first}\nMulticastPort = {first - 1}\n"
                "[multicast]\nResolveScope = machine\n"
            )
            return attempt
    raise AssertionError("no ports")


def _is_free(port: int) -> bool:
    try:
        for kind in (TCP, UDP):
            with socket.socket(socket.AF_INET, kind) as attempt:
                attempt.bind(("", port))
    except OSError:
        return False
    return True


def settings(devices: str = "", count: int = COUNT) -> str:
    return f"[lsl]\nport_range = {count}\n{devices}"


def test_free_ports(examine: Examine, configured: Callable[[str], Context], ports: range) -> None:
    found = examine(configured(settings(POLAR)), "ports")
    assert not above_ok(found)
    said = f"{ports[0]} to {ports[-1]}: {COUNT} of {COUNT} ports are free"
    assert [each.what for each in found[1:]] == [f"TCP {said}", f"UDP {said}"]


def test_held_ports_and_by_whom(
    examine: Examine, configured: Callable[[str], Context], ports: range, hold: Hold
) -> None:
    for port in ports[:3]:
        hold(TCP, port)
    hold(UDP, ports[5])
    found = examine(configured(settings(POLAR)), "ports")
    assert not above_ok(found)
    me = f"(process {os.getpid()})"
    assert f": {COUNT - 3} of {COUNT} ports are free" in only(found, f"{me}: 3").what
    assert f": {COUNT - 1} of {COUNT} ports are free" in only(found, f"UDP {ports[0]} to").what


def test_too_few_free_ports_are_an_error(
    examine: Examine, configured: Callable[[str], Context], ports: range, hold: Hold
) -> None:
    for port in ports[: COUNT - 8]:
        hold(UDP, port)
    (found,) = above_ok(examine(configured(settings(POLAR)), "ports"))
    assert found.level is Level.ERROR
    assert "UDP" in found.what
    # Seven streams and the agent's own, two ports each.
    assert "the streams in the settings need 16" in found.what
    assert (str(ports[0]) in found.fix) == (sys.platform == "linux")


def test_a_range_that_is_too_small_is_a_warning(
    examine: Examine, configured: Callable[[str], Context], ports: range
) -> None:
    del ports
    found = above_ok(examine(configured(settings(POLAR + ZEPHYR.format("/dev/x"), 8)), "ports"))
    assert [each.level for each in found] == [Level.WARNING] * 2
    assert all("port_range = 256" in each.fix for each in found)


def test_discovery_that_another_program_has_alone(
    examine: Examine, context: Context, ports: range, hold: Hold
) -> None:
    hold(UDP, ports[0] - 1)
    (found,) = above_ok(examine(context, "ports"))
    assert found.level is Level.ERROR
    assert found.what.startswith(f"UDP {ports[0] - 1} is held exclusively by ")
    assert f"(process {os.getpid()})" in found.what


def test_what_the_other_checks_hold_is_free(
    examine: Examine, configured: Callable[[str], Context], ports: range
) -> None:
    context = configured(settings())
    with Probe("offer", 30.0, config=context.config, source_id="doctor") as probe:
        assert probe.answer() == {"open": True}
        found = examine(context, "ports")
    assert f"TCP {ports[0]} to {ports[-1]}: {COUNT} of {COUNT} ports are free" == found[1].what


def test_discovery_is_shared_by_lsl_programs(
    examine: Examine, context: Context, session: str, offer: Callable[..., None]
) -> None:
    offer(Offered(session, session))
    found = examine(context, "ports")
    assert only(found, "UDP 16571 (discovery) is available")
    assert "python" in only(found, "TCP 16572").what


# The LSL configuration in force; what the check says of it is compared with liblsl itself.
Write = Callable[[str], Path]
Configured = Callable[[str], Context]


def session_of_liblsl(configured: str = "") -> str:
    """The session that a program of the user is in, by liblsl's own reading."""
    code = (
        f"{configured}\nimport pylsl; "
        "o = pylsl.StreamOutlet(pylsl.StreamInfo('a', 'b', 1, 0, 'float32', 'c'));"
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


def test_a_value_for_which_liblsl_would_drop_the_session_is_an_error(
    examine: Examine, context: Context, lsl_file: Write
) -> None:
    lsl_file("[lab]\nSessionID = lab7\n[multicast]\nResolveScope = campus\n")
    (found,) = above_ok(examine(context, "lsl_config"))
    assert found.level is Level.ERROR
    assert "ResolveScope = campus" in found.what
    assert session_of_liblsl() == "default"


def test_peers_without_braces_and_an_empty_value_are_heeded_by_our_programs(
    examine: Examine, context: Context, lsl_file: Write
) -> None:
    lsl_file("[lab]\nKnownPeers = 127.0.0.1, 127.0.0.2\n")
    found = only(examine(context, "lsl_config"), "KnownPeers has no braces")
    assert found.level is Level.WARNING
    assert "{127.0.0.1, 127.0.0.2}" in found.fix
    path = lsl_file("[lab]\nKnownPeers =\n")
    configured = f"""
import pylsl
from pathlib import Path
from biosensor_common.lsl.api_file import LslOverrides, effective_config
text = effective_config(Path({str(path)!r}), LslOverrides("lab7"))
pylsl.set_config_content(text)
"""
    assert session_of_liblsl(configured) == "lab7"


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


def test_a_session_that_no_query_can_name(
    examine: Examine, context: Context, lsl_file: Write
) -> None:
    path = lsl_file("[lab]\nSessionID = Lab's 1\n")
    found = only(examine(context, "lsl_config"), "apostrophe")
    assert found.level is Level.ERROR
    assert str(path) in found.what


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
