"""The computer itself: sleep, battery, clock, firewalls, network adapters."""

from __future__ import annotations

import json
import os
import re
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil
import pytest

from biosensor_common import child
from biosensor_common.doctor import computer, firewall, interfaces, windows_firewall
from biosensor_common.doctor.check import Finding, Level
from biosensor_common.doctor.interfaces import Interface
from biosensor_common.doctor.windows_firewall import Network
from biosensor_common.lsl.api_file import Ports
from biosensor_gateway.doctor import device_checks
from biosensor_gateway.doctor.context import Context
from tests.doctor.conftest import above_ok, only
from tests.doctor.outlets import Offered, arguments, running
from tests.rigs.hosts.lan import NETWORK, Host, Lan

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

# The computer itself: sleep, battery, clock, firewalls.

Install = Callable[[str, str], None]
PORTS = Ports(16571, 16572, 16827)


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Have programs of the system that say what a test wants."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}/usr/bin{os.pathsep}/bin")

    def write(name: str, script: str) -> None:
        program = folder / name
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)

    return write


@pytest.mark.nightly
def test_programs_that_are_not_there_or_hang(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert child.output_of("no-such-program") is None
    install("slow", "exec sleep 60")
    monkeypatch.setattr(child, "TIME_LIMIT_S", 0.2)
    assert child.succeeds("slow") is None


@pytest.mark.parametrize(
    ("limit", "streams", "level", "words"),
    [
        (None, 500, Level.OK, "does not limit"),
        (65536, 108, Level.OK, "65536 files, which is enough to send 3273 streams"),
        (1024, 20, Level.NOTE, "1024 files, which is enough to send 48 streams or receive 80"),
        (1024, 60, Level.ERROR, "the settings have 60 streams"),
    ],
)
def test_the_limit_of_open_files_is_judged_by_the_streams_that_fit(
    limit: int | None, streams: int, level: Level, words: str
) -> None:
    finding = computer.judge_limit(limit, streams)
    assert finding.level is level
    assert words in finding.what
    assert level is Level.OK or "then start it again" in finding.fix


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["ufw", "firewalld"])
def test_a_firewall_of_linux_is_named_with_its_command(
    examine: Examine,
    context: Context,
    install: Install,
    lsl_file: Callable[[str], Path],
    name: str,
) -> None:
    lsl_file("[ports]\nPortRange = 256\n")
    install("systemctl", f'[ "$1 $2" = "is-active {name}" ]')
    (found,) = examine(context, "linux_firewall")
    assert (found.level, found.what) == (Level.NOTE, f"the firewall {name} is on")
    ways = firewall.every(PORTS)
    command = firewall.ufw(ways) if name == "ufw" else firewall.firewalld(ways)
    assert found.fix == command


@pytest.mark.nightly
def test_sleep_of_the_desktop(examine: Examine, context: Context, install: Install) -> None:
    install("systemctl", "echo static")
    install("gsettings", "echo \"'suspend'\"")
    note = only(examine(context, "power"), "goes to sleep when it is idle")
    assert note.level is Level.NOTE
    assert note.fix.startswith("gsettings set ")
    warned = only(examine(replace(context, keep_awake=False), "power"), "goes to sleep")
    assert warned.level is Level.WARNING
    install("systemctl", "echo masked")
    assert only(examine(context, "power"), "no setting is known that sends")


@pytest.mark.parametrize(
    ("systemctl", "gsettings", "goes"),
    [
        ("masked\n", "'suspend'", False),
        ("static\n", "'suspend'", True),
        ("static\n", "'nothing'", False),
        (None, "'suspend'", True),
        (None, None, False),
    ],
)
def test_a_computer_whose_sleep_is_masked_stays_awake(
    monkeypatch: pytest.MonkeyPatch,
    context: Context,
    systemctl: str | None,
    gsettings: str | None,
    goes: bool,
) -> None:
    answers = {"systemctl": systemctl, "gsettings": gsettings}

    def output_of(name: str, *_: str) -> str | None:
        return answers.get(name)

    monkeypatch.setattr(child, "output_of", output_of)
    monkeypatch.setattr(sys, "platform", "linux")
    found = [each.what for each in device_checks.power(context)]
    assert any("this computer goes to sleep" in each for each in found) is goes
    assert any("no setting is known that sends" in each for each in found) is not goes


@pytest.mark.parametrize("error", [FileNotFoundError, AttributeError])
def test_a_computer_that_knows_no_batteries_is_judged(
    monkeypatch: pytest.MonkeyPatch, context: Context, error: type[Exception]
) -> None:
    def sensors_battery() -> None:
        raise error("/sys/class/power_supply")

    def output_of(*_: str) -> None:
        return None

    monkeypatch.setattr(psutil, "sensors_battery", sensors_battery)
    monkeypatch.setattr(child, "output_of", output_of)
    assert not any("battery" in each.what for each in device_checks.power(context))


def test_adapters_that_may_be_suspended(tmp_path: Path) -> None:
    """A tree as the kernel's: the adapter's device is an interface of the USB device."""
    for name, control in (("hci0", "auto"), ("hci1", "on")):
        usb = tmp_path / f"usb-{name}"
        (usb / "interface").mkdir(parents=True)
        (usb / "power").mkdir()
        (usb / "power/control").write_text(f"{control}\n")
        (tmp_path / "bluetooth" / name).mkdir(parents=True)
        (tmp_path / "bluetooth" / name / "device").symlink_to(usb / "interface")
    (found,) = device_checks.adapters(tmp_path / "bluetooth")
    assert (found.level, "hci0" in found.what) == (Level.NOTE, True)
    assert f"tee {tmp_path / 'usb-hci0/power/control'}" in found.fix
    assert not list(device_checks.adapters(tmp_path / "none"))


@pytest.mark.parametrize(
    ("running", "shown", "level"),
    [
        ([], "NTP=no\nNTPSynchronized=no\n", Level.NOTE),
        ([], "", Level.NOTE),
        (["chronyd"], "", Level.OK),
        (["systemd-timesyn"], "NTP=yes\nNTPSynchronized=yes\n", Level.OK),
        (["ptp4l"], "NTP=no\nNTPSynchronized=no\n", Level.NOTE),
        (["ptp4l"], "NTP=no\nNTPSynchronized=yes\n", Level.OK),
        (["ptp4l", "phc2sys"], "NTP=no\nNTPSynchronized=no\n", Level.OK),
        (["chronyd"], "NTP=yes\nNTPSynchronized=no\n", Level.NOTE),
        ([], "NTP=yes\nNTPSynchronized=yes\n", Level.OK),
    ],
)
def test_what_keeps_the_clock(running: list[str], shown: str, level: Level) -> None:
    assert [each.level for each in computer.judge_clock(running, shown)] == [level]


def test_programs_that_set_the_clock_against_each_other() -> None:
    synchronised = "NTP=yes\nNTPSynchronized=yes\n"
    for programs in (["chronyd", "systemd-timesyn"], ["chronyd", "phc2sys", "ptp4l"]):
        quarrel, kept = computer.judge_clock(programs, synchronised)
        assert (quarrel.level, kept.level) == (Level.WARNING, Level.OK)
        assert quarrel.fix.startswith("keep only one of them")
    # timemaster lets phc2sys speak to chronyd only.
    (kept,) = computer.judge_clock(["chronyd", "phc2sys", "ptp4l", "timemaster"], synchronised)
    assert kept.level is Level.OK


@pytest.mark.parametrize(
    ("said", "source", "offset_s", "bound_s"),
    [
        # The fields of chronyd 4.3; the first and the last as it really said them.
        (
            "7F7F0101,,8,1795282219.2,0.000000000,0.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,Normal\n",
            "7F7F0101",
            0.0,
            0.0,
        ),
        (
            "C0A80101,192.168.1.1,3,1795282219.2,-0.00025,0.0,0.0,1.2,0.0,0.1,0.002,0.0005,6,Normal\n",
            "192.168.1.1",
            -0.00025,
            0.00175,
        ),
        ("00000000,,0,0.0,0.0,0.0,0.0,0.0,0.0,0.0,1.0,1.0,0.0,Not synchronised\n", "", 0.0, 1.5),
    ],
)
def test_what_chrony_says(said: str, source: str, offset_s: float, bound_s: float) -> None:
    tracking = computer.tracking(said)
    assert tracking is not None
    assert tracking.source == source
    assert (tracking.offset_s, tracking.bound_s) == pytest.approx((offset_s, bound_s))


@pytest.mark.parametrize(
    ("tracking", "level", "part"),
    [
        (computer.Tracking("192.168.1.1", -0.00025, 0.00175), Level.OK, "estimated -0.250 ms"),
        (computer.Tracking("192.168.1.1", 0.001, 0.2), Level.NOTE, "at most 200.000 ms"),
        (computer.Tracking("", 0.0, 1.5), Level.NOTE, "not synchronised"),
    ],
)
def test_how_far_chrony_is_off(tracking: computer.Tracking, level: Level, part: str) -> None:
    (found,) = computer.judge_clock(["chronyd"], "NTP=yes\nNTPSynchronized=yes\n", tracking)
    assert (found.level, part in found.what) == (level, True)


@pytest.mark.parametrize("said", ["", "506 Cannot talk to daemon\n", "a,b,c"])
def test_a_chrony_that_does_not_answer(said: str) -> None:
    assert computer.tracking(said) is None


@pytest.mark.nightly
def test_the_clock_of_this_computer_is_judged(examine: Examine, context: Context) -> None:
    assert len(examine(context, "clock")) == 1


@pytest.mark.nightly
def test_checks_of_other_systems_say_nothing(examine: Examine, context: Context) -> None:
    assert not examine(context, "windows_firewall")


def test_networks_of_windows() -> None:
    assert windows_firewall.judge_network("Lab", Network.PRIVATE).level is Level.OK
    public = windows_firewall.judge_network("Lab", Network.PUBLIC)
    assert (public.level, "Private network" in public.fix) == (Level.WARNING, True)


def test_the_latest_network_of_windows() -> None:
    """SYSTEMTIME: year, month, weekday, day, hour, minute, second, milliseconds."""
    before = struct.pack("<8H", 2026, 11, 6, 21, 9, 59, 59, 0)
    after = struct.pack("<8H", 2026, 12, 2, 1, 0, 0, 0, 0)
    assert windows_firewall.sortable(before) < windows_firewall.sortable(after)


def test_the_rule_for_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = firewall.windows(PORTS)
    assert "protocol=UDP localport=16571,16572-16827" in ports
    assert "protocol=TCP localport=16572-16827" in ports
    monkeypatch.setattr("sys.frozen", True, raising=False)
    monkeypatch.setattr("sys.executable", r"C:\Program Files\Biosensor Gateway\x.exe")
    assert r'program="C:\Program Files\Biosensor Gateway\x.exe"' in firewall.windows(PORTS)


@pytest.mark.nightly
def test_a_finding_is_above_ok_only_with_a_remedy(examine: Examine, context: Context) -> None:
    for name in ("power", "clock", "linux_firewall", "host_name"):
        assert all(each.fix for each in above_ok(examine(context, name)))


# Network adapters; what systems with others have is in test_networks.py.
LO = Interface("lo", ("127.0.0.1",), has_multicast=False)
CABLE = Interface("eth0", ("10.77.0.1",), has_multicast=True)
RADIO = Interface("Wi-Fi", ("192.168.1.20",), has_multicast=True)
DOCKER = Interface("docker0", ("172.17.0.1",), has_multicast=True)
Show = Callable[..., list[Finding]]


@pytest.fixture
def show(examine: Examine, context: Context, monkeypatch: pytest.MonkeyPatch) -> Show:
    """Examine a computer that has these adapters, and multicast leaves through that address."""

    def examined(*adapters: Interface, way: str = "") -> list[Finding]:
        monkeypatch.setattr(interfaces, "adapters", lambda: list(adapters))
        monkeypatch.setattr(interfaces, "route", lambda: way)
        return examine(context, "interfaces")

    return examined


@pytest.mark.nightly
def test_this_computer_is_described(examine: Examine, context: Context) -> None:
    assert examine(context, "interfaces")
    assert "127.0.0.1" in [each for one in interfaces.adapters() for each in one.addresses]


@pytest.mark.nightly
def test_a_network_is_all_right(show: Show) -> None:
    found = show(LO, CABLE, way="10.77.0.1")
    assert [each.what for each in found] == [
        "eth0 (10.77.0.1) is up",
        "multicast leaves through eth0 (10.77.0.1) first",
    ]
    assert not above_ok(found)


@pytest.mark.nightly
def test_no_network_and_how_to_live_with_it(show: Show, lsl_file: Callable[[str], Path]) -> None:
    lsl_file("")
    (found,) = show(LO)
    assert found.level is Level.WARNING
    assert found.fix.startswith("biosensor-gateway config lsl\n")
    lsl_file("[lab]\nKnownPeers = {127.0.0.1}\n[ports]\nPortRange = 256\n")
    (found,) = show(LO)
    assert found.level is Level.OK


@pytest.mark.nightly
def test_multicast_by_a_virtual_adapter_is_said(show: Show) -> None:
    found = above_ok(show(LO, CABLE, DOCKER, way="172.17.0.1"))
    assert [(each.level, "docker0" in each.what) for each in found] == [
        (Level.NOTE, True),
        (Level.NOTE, True),
    ]


@pytest.mark.nightly
def test_several_networks_are_a_note(show: Show) -> None:
    (found,) = above_ok(show(CABLE, RADIO, way="10.77.0.1"))
    assert (found.level, found.what[:11]) == (Level.NOTE, "2 networks:")


@pytest.mark.nightly
def test_a_cable_between_two_computers_is_a_note(show: Show) -> None:
    found = only(above_ok(show(DOCKER, CABLE)), "has no preferred route for multicast")
    assert found.level is Level.NOTE
    assert "224.0.0.0/4 dev eth0" in found.fix


@pytest.mark.parametrize(
    "name",
    [
        "docker0",
        "br-3f2a",
        "veth12ab",
        "virbr0",
        "tun0",
        "wg0",
        "tailscale0",
        "vEthernet (WSL (Hyper-V firewall))",
        "VMware Network Adapter VMnet8",
        "VirtualBox Host-Only Network",
        "Lab VPN",
    ],
)
def test_virtual_adapters_are_known_by_name(name: str) -> None:
    assert Interface(name, ("10.0.0.1",), has_multicast=True).is_virtual


@pytest.mark.parametrize(
    "name", ["eth0", "enp3s0", "wlan0", "wlp2s0", "Ethernet 2", "Wi-Fi", "en0"]
)
def test_real_adapters_are(name: str) -> None:
    assert not Interface(name, ("10.0.0.1",), has_multicast=True).is_virtual


@pytest.mark.parametrize(
    ("name", "level"),
    [("lab-pc", Level.OK), ("Lab PC", Level.WARNING), ("m\u00fcller", Level.WARNING)],
)
def test_names_of_computers(name: str, level: Level) -> None:
    assert computer.judge_name(name).level is level


# Whole computers, made of namespaces: no network, no multicast, no way for it, two hosts.


_CHOSEN = {"LSLAPICFG", "BIOSENSOR_GATEWAY_SETTINGS", "BIOSENSOR_GATEWAY_STATE"}
_PROGRAM = "from tests.doctor.conftest import program; program()()"
# Nothing but unicast gets in.
_NO_MULTICAST = """table inet office {
    chain arriving {
        type filter hook input priority 0
        meta pkttype { broadcast, multicast } drop
    }
}
"""
_NO_UNICAST = """table inet office {
    chain arriving {
        type filter hook input priority 0
        udp dport 16572-16827 drop
        tcp dport 16572-16827 drop
    }
}
"""
CHECKS = ("interfaces", "discovery", "streams", "lsl_config")


def environment(host: Host, folder: Path) -> dict[str, str]:
    home = folder / host.name
    home.mkdir(exist_ok=True)
    inherited = {name: value for name, value in os.environ.items() if name not in _CHOSEN}
    return inherited | {
        "HOME": str(home),
        "XDG_CONFIG_HOME": str(home),
        "XDG_STATE_HOME": str(home),
    }


def doctor(host: Host, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Run doctor on a computer; return the findings of each check."""
    only = [part for name in CHECKS for part in ("--only", name)]
    done = subprocess.run(
        host.command(sys.executable, "-c", _PROGRAM, "doctor", "--json", *only),
        env=environment(host, folder),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""
    content = json.loads(done.stdout)
    print(f"{host.name}: {content['seconds']} s")
    for each in content["findings"]:
        print(f"  {each['level']} {each['check']}: {each['what']}")
        assert not each["what"].startswith("the check")
        assert each["level"] == "ok" or each["fix"]
    assert done.returncode == (0 if content["good"] else 1)
    return {
        name: [each for each in content["findings"] if each["check"] == name] for name in CHECKS
    }


def _offering(host: Host, folder: Path, *streams: Offered) -> AbstractContextManager[None]:
    command = host.command(sys.executable, *arguments("default", streams, "site"))
    return running(command, environment(host, folder))


def levels(findings: list[dict[str, Any]]) -> list[str]:
    return [each["level"] for each in findings]


@pytest.mark.seam
@pytest.mark.timeout(300)
def test_no_network(tmp_path: Path) -> None:
    with Host("lab-pc") as host:
        before = doctor(host, tmp_path)
        write = [sys.executable, "-m", "biosensor_gateway.cli", "config", "lsl"]
        subprocess.run(
            host.command(*write), env=environment(host, tmp_path), check=True, capture_output=True
        )
        after = doctor(host, tmp_path)
    (cause,) = before["interfaces"]
    assert (cause["level"], cause["what"]) == (
        "warning",
        "no network is up, only the loopback",
    )
    assert "biosensor-gateway config lsl" in cause["fix"]
    assert levels(before["discovery"]) == ["ok", "warning"]
    # What it says is what helps.
    assert levels(after["interfaces"]) == ["ok"]
    assert "lsl_api/lsl_api.cfg" in after["lsl_config"][0]["what"]


@pytest.mark.system
@pytest.mark.timeout(300)
def test_a_cable_and_the_streams_of_the_other_computer(tmp_path: Path) -> None:
    offered = Offered("good", "good-1"), Offered("bad", "")
    with (
        Lan({"agent-pc": 0, "desk": 5000}) as lan,
        _offering(lan["agent-pc"], tmp_path, *offered),
    ):
        found = doctor(lan["desk"], tmp_path)
    # No default route, and LSL finds its way.
    assert levels(found["interfaces"]) == ["ok", "note"]
    assert "ip route add 224.0.0.0/4 dev eth0" in found["interfaces"][1]["fix"]
    assert f"eth0 ({NETWORK}.2)" in found["interfaces"][0]["what"]
    assert levels(found["discovery"]) == ["ok", "ok"]
    host, empty = found["streams"]
    said = re.fullmatch(r"2 streams on agent-pc: clock offset ([+-][\d.]+) s, .*", host["what"])
    assert said is not None
    assert abs(float(said[1]) - 5000.0) < 0.05
    assert (host["level"], empty["what"]) == ("ok", "without a source_id: bad")


@pytest.mark.system
@pytest.mark.timeout(300)
def test_no_multicast(tmp_path: Path) -> None:
    with Lan({"agent-pc": 0, "desk": 0}) as lan:
        desk = lan["desk"]
        desk.run("ip", "route", "add", "default", "via", f"{NETWORK}.1")
        desk.run("nft", "-f", "-", text=_NO_MULTICAST)
        filtered = doctor(desk, tmp_path)
        desk.run("nft", "delete", "table", "inet", "office")
        desk.run("ip", "link", "set", "eth0", "multicast", "off")
        switched_off = doctor(desk, tmp_path)
    assert levels(filtered["interfaces"]) == ["ok", "ok"]
    (unicast, multicast) = filtered["discovery"]
    assert (unicast["level"], multicast["level"]) == ("ok", "warning")
    assert "sudo ufw allow 16571/udp" in multicast["fix"]
    assert switched_off["interfaces"][0]["level"] == "warning"
    assert "ip link set eth0 multicast on" in switched_off["interfaces"][0]["fix"]


@pytest.mark.system
@pytest.mark.timeout(300)
def test_a_firewall_on_this_computer_itself(tmp_path: Path) -> None:
    with Lan({"agent-pc": 0}) as lan:
        lan["agent-pc"].run("nft", "-f", "-", text=_NO_UNICAST)
        found = doctor(lan["agent-pc"], tmp_path)
    unicast, multicast = found["discovery"]
    assert (unicast["level"], multicast["level"]) == ("error", "ok")
    assert "16572:16827/tcp" in unicast["fix"]
