"""The computer itself: sleep, battery, clock, firewalls."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_gateway.doctor import firewall_rules, programs
from biosensor_gateway.doctor.checks import clock, power, windows_firewall
from biosensor_gateway.doctor.checks.windows_firewall import Network
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.doctor.finding import Level
from biosensor_gateway.lsl_file import Ports
from tests.doctor.conftest import above_ok, only

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

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


def test_programs_that_are_not_there_or_hang(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert programs.output_of("no-such-program") is None
    install("slow", "exec sleep 60")
    monkeypatch.setattr(programs, "TIME_LIMIT_S", 0.2)
    assert programs.succeeds("slow") is None


@pytest.mark.parametrize("name", ["ufw", "firewalld"])
def test_a_firewall_of_linux_is_named_with_its_command(
    examine: Examine, context: Context, install: Install, name: str
) -> None:
    install("systemctl", f'[ "$1 $2" = "is-active {name}" ]')
    (found,) = examine(context, "linux_firewall")
    assert (found.level, found.what) == (Level.NOTE, f"the firewall {name} is on")
    command = firewall_rules.ufw(PORTS) if name == "ufw" else firewall_rules.firewalld(PORTS)
    assert found.fix == command


def test_sleep_of_the_desktop(examine: Examine, context: Context, install: Install) -> None:
    install("systemctl", "echo static")
    install("gsettings", "echo \"'suspend'\"")
    note = only(examine(context, "power"), "goes to sleep when nobody uses it")
    assert note.level is Level.NOTE
    assert note.fix.startswith("gsettings set ")
    warned = only(examine(replace(context, keep_awake=False), "power"), "goes to sleep")
    assert warned.level is Level.WARNING
    install("systemctl", "echo masked")
    assert only(examine(context, "power"), "nothing is known to send")


def test_adapters_that_may_be_suspended(tmp_path: Path) -> None:
    """A tree as the kernel's: the adapter's device is an interface of the USB device."""
    for name, control in (("hci0", "auto"), ("hci1", "on")):
        usb = tmp_path / f"usb-{name}"
        (usb / "interface").mkdir(parents=True)
        (usb / "power").mkdir()
        (usb / "power/control").write_text(f"{control}\n")
        (tmp_path / "bluetooth" / name).mkdir(parents=True)
        (tmp_path / "bluetooth" / name / "device").symlink_to(usb / "interface")
    (found,) = power.adapters(tmp_path / "bluetooth")
    assert (found.level, "hci0" in found.what) == (Level.NOTE, True)
    assert f"tee {tmp_path / 'usb-hci0/power/control'}" in found.fix
    assert not list(power.adapters(tmp_path / "none"))


@pytest.mark.parametrize(
    ("running", "shown", "level"),
    [
        ([], "NTP=no\nNTPSynchronized=no\n", Level.NOTE),
        ([], "", Level.NOTE),
        (["chronyd"], "", Level.OK),
        (["systemd-timesyn"], "NTP=yes\nNTPSynchronized=yes\n", Level.OK),
        (["ptp4l"], "NTP=no\n", Level.OK),
        (["chronyd"], "NTP=yes\nNTPSynchronized=no\n", Level.NOTE),
        ([], "NTP=yes\nNTPSynchronized=yes\n", Level.OK),
    ],
)
def test_what_keeps_the_clock(running: list[str], shown: str, level: Level) -> None:
    assert clock.judge(running, shown).level is level


def test_the_clock_of_this_computer_is_judged(examine: Examine, context: Context) -> None:
    assert len(examine(context, "clock")) == 1


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
    ports = firewall_rules.windows(PORTS)
    assert "protocol=UDP localport=16571,16572-16827" in ports
    assert "protocol=TCP localport=16572-16827" in ports
    monkeypatch.setattr("sys.frozen", True, raising=False)
    monkeypatch.setattr("sys.executable", r"C:\Program Files\Biosensor Gateway\x.exe")
    assert r'program="C:\Program Files\Biosensor Gateway\x.exe"' in firewall_rules.windows(PORTS)


def test_a_finding_is_above_ok_only_with_a_remedy(examine: Examine, context: Context) -> None:
    for name in ("power", "clock", "linux_firewall", "host_name"):
        assert all(each.fix for each in above_ok(examine(context, name)))
