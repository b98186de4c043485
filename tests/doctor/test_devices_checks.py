"""Bluetooth, serial ports and services: with virtual devices, and without."""

from __future__ import annotations

import grp
import os
import pwd
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_common.doctor.check import Level
from biosensor_gateway.devices.emotiv_insight.simulator import Licence
from biosensor_gateway.devices.empatica_e4.simulator import SimulatedE4
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.doctor import device_checks as checks
from biosensor_gateway.doctor.context import Context
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from biosensor_gateway.transports import ble_errors
from tests.doctor.conftest import E4, POLAR, ZEPHYR, above_ok, only
from tests.emotiv_insight.steering import SteeredCortex

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

Configured = Callable[[str], Context]
CORTEX = '[[device]]\nsensor = "emotiv_insight"\nunit = "1"\nurl = "{}"\nca_file = "{}"\n'


@pytest.fixture(autouse=True)
def no_secrets(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("EMOTIV_CLIENT_ID", "EMOTIV_CLIENT_SECRET"):
        monkeypatch.delenv(variable, raising=False)


@pytest.fixture
def free_port() -> int:
    with socket.socket() as attempt:
        attempt.bind(("127.0.0.1", 0))
        port: int = attempt.getsockname()[1]
        return port


# ---- Bluetooth -------------------------------------------------------------------------


@pytest.mark.nightly
def test_bluetooth_that_is_on(
    examine: Examine, configured: Configured, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "LISTEN_S", 1.5)
    radio = Radio(world)
    with virtual_bluetooth(radio), SimulatedPolarH10(world, radio):
        (found,) = examine(configured(POLAR), "bluetooth")
    assert (found.level, "1 device was heard" in found.what) == (Level.OK, True)


@pytest.mark.nightly
def test_on_windows_it_says_what_was_not_seen_with_a_real_device(
    examine: Examine, configured: Configured, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "LISTEN_S", 1.5)
    monkeypatch.setattr(ble_errors, "PLATFORM", "win32")
    radio = Radio(world)
    with virtual_bluetooth(radio), SimulatedPolarH10(world, radio):
        on_air, unseen = examine(configured(POLAR), "bluetooth")
        assert len(examine(configured(""), "bluetooth")) == 1
    assert (on_air.level, unseen.level) == (Level.OK, Level.OK)
    assert unseen.what == checks.UNSEEN_ON_WINDOWS


@pytest.mark.nightly
def test_silence_where_a_device_is_needed_is_a_note(
    examine: Examine, configured: Configured, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "LISTEN_S", 0.3)
    with virtual_bluetooth(Radio(world)):
        (found,) = above_ok(examine(configured(POLAR), "bluetooth"))
        assert found.level is Level.NOTE
        assert not above_ok(examine(configured(""), "bluetooth"))


@pytest.mark.nightly
def test_no_bluetooth_is_an_error_only_for_who_needs_it(
    examine: Examine, configured: Configured, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", f"unix:path={tmp_path / 'no-bus'}")
    (needed,) = examine(configured(POLAR), "bluetooth")
    assert needed.level is Level.ERROR
    assert "polar_h10" in needed.why
    assert "systemctl start bluetooth" in needed.fix
    (unneeded,) = examine(configured(ZEPHYR.format("/dev/rfcomm0")), "bluetooth")
    assert unneeded.level is Level.NOTE


# ---- serial ports ----------------------------------------------------------------------


@pytest.mark.nightly
def test_a_port_that_is_there(examine: Examine, configured: Configured) -> None:
    master, slave = os.openpty()
    try:
        (found,) = examine(configured(ZEPHYR.format(os.ttyname(slave))), "serial")
    finally:
        os.close(master)
        os.close(slave)
    assert (found.level, "can be opened" in found.what) == (Level.OK, True)


@pytest.mark.nightly
def test_a_port_that_is_not_there(examine: Examine, configured: Configured) -> None:
    (found,) = examine(configured(ZEPHYR.format("/dev/rfcomm77")), "serial")
    assert found.level is Level.ERROR
    assert "there is no port /dev/rfcomm77" in found.what
    assert "biosensor-gateway scan" in found.fix


@pytest.mark.nightly
def test_a_device_that_is_not_paired(examine: Examine, configured: Configured) -> None:
    (found,) = examine(configured(ZEPHYR.format("00:07:80:5A:3E:7E")), "serial")
    assert found.level is Level.WARNING
    assert "bluetoothctl pair 00:07:80:5A:3E:7E" in found.fix


@pytest.mark.nightly
def test_disabled_devices_are_not_looked_at(examine: Examine, configured: Configured) -> None:
    text = ZEPHYR.format("/dev/rfcomm77") + "enabled = false\n"
    assert not above_ok(examine(configured(text), "serial"))


@pytest.mark.system
def test_a_port_of_a_group_that_the_user_is_not_in() -> None:
    """Only root can make a file that another user may not open, and be that user."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ttyUSB0"
        path.touch()
        os.chown(path, 0, grp.getgrnam("dialout").gr_gid)
        path.chmod(0o660)
        Path(folder).chmod(0o755)
        level, what, fix = _as_nobody(path).split("|")
    assert level == "error"
    assert "you do not have permission to open" in what
    assert fix == 'sudo usermod -aG dialout "$USER", then log out and in'


def _as_nobody(path: Path) -> str:
    nobody = pwd.getpwnam("nobody")
    code = (
        # What is imported later, that user may not read.
        "import getpass, grp, os, pwd; from pathlib import Path; "
        "from biosensor_gateway.doctor.device_checks import device_file; "
        f"os.setgroups([]); os.setgid({nobody.pw_gid}); os.setuid({nobody.pw_uid}); "
        f"found = device_file(Path({str(path)!r}), 'zephyr'); "
        "print(found.level, found.what, found.fix, sep='|')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


# ---- services --------------------------------------------------------------------------


@pytest.mark.nightly
def test_an_e4_server_that_runs_and_one_that_does_not(
    examine: Examine, configured: Configured, world: World, free_port: int
) -> None:
    with SimulatedE4(world) as server:
        found = examine(configured(E4.format(server.settings["port"])), "services")
        assert only(found, f"{server.settings['port']} answers").level is Level.OK
    down = only(examine(configured(E4.format(free_port)), "services"), f":{free_port}")
    assert down.level is Level.ERROR
    assert "E4 streaming server" in down.fix


@pytest.mark.nightly
def test_cortex_with_its_certificate_and_without(
    examine: Examine, configured: Configured, world: World
) -> None:
    with SteeredCortex(world) as cortex:
        url, ca_file = cortex.settings["url"], cortex.settings["ca_file"]
        good = examine(configured(CORTEX.format(url, ca_file)), "services")
        untrusted = examine(configured(CORTEX.format(url, "")), "services")
        no_file = examine(configured(CORTEX.format(url, "/no/such.pem")), "services")
    assert only(good, "answers with a trusted certificate").level is Level.OK
    assert only(untrusted, "its certificate is not trusted").level is Level.ERROR
    assert only(no_file, "/no/such.pem").level is Level.ERROR


@pytest.mark.nightly
def test_secrets_of_services(
    examine: Examine, configured: Configured, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    context = configured(CORTEX.format(f"wss://localhost:{free_port}", ""))
    missing = only(examine(context, "services"), "client secret")
    assert (missing.level, missing.fix) == (
        Level.ERROR,
        "biosensor-gateway secrets set emotiv_insight",
    )
    monkeypatch.setenv("EMOTIV_CLIENT_ID", "an id")
    monkeypatch.setenv("EMOTIV_CLIENT_SECRET", "hush-hush")
    found = examine(context, "services")
    assert only(found, "client secret").level is Level.OK
    assert "hush-hush" not in str(found)


# ---- licences --------------------------------------------------------------------------


@pytest.fixture
def cortex(world: World, monkeypatch: pytest.MonkeyPatch) -> Generator[SteeredCortex]:
    with SteeredCortex(world) as service:
        for variable, secret in service.environment.items():
            monkeypatch.setenv(variable, secret)
        yield service


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("licence", "streams"),
    [
        (Licence.EEG | Licence.METRICS, []),
        (Licence.METRICS, ["eeg_status"]),
        (Licence.EEG, ["met comes"]),
        (Licence.NONE, ["eeg_status", "met comes"]),
    ],
)
def test_what_a_licence_does_not_cover_is_named(
    examine: Examine,
    configured: Configured,
    cortex: SteeredCortex,
    licence: Licence,
    streams: list[str],
) -> None:
    cortex.license(licence)
    # Two headsets of one account: it is asked once.
    table = CORTEX.format(cortex.settings["url"], cortex.settings["ca_file"])
    found = examine(configured(table + table.replace('"1"', '"2"')), "licences")
    missed = above_ok(found)
    assert [each.level for each in missed] == [Level.WARNING] * len(streams)
    assert all(stream in each.what for each, stream in zip(missed, streams, strict=True))
    assert len(found) == max(1, len(streams))


@pytest.mark.nightly
def test_who_is_not_logged_in_is_an_error_and_who_cannot_be_asked_a_note(
    examine: Examine, configured: Configured, cortex: SteeredCortex, free_port: int
) -> None:
    url, ca_file = cortex.settings["url"], cortex.settings["ca_file"]
    cortex.log_out()
    (found,) = examine(configured(CORTEX.format(url, ca_file)), "licences")
    assert (found.level, "log in there" in found.what) == (Level.ERROR, True)
    away = configured(CORTEX.format(f"wss://localhost:{free_port}", ca_file))
    (found,) = examine(away, "licences")
    assert (found.level, "--only services" in found.fix) == (Level.NOTE, True)


@pytest.mark.nightly
def test_without_secrets_or_a_licensed_sensor_nothing_is_asked(
    examine: Examine, configured: Configured, free_port: int
) -> None:
    table = CORTEX.format(f"wss://localhost:{free_port}", "")
    assert examine(configured(table), "licences") == []
    assert examine(configured(POLAR), "licences") == []


@pytest.mark.nightly
def test_labrecorder_s_remote_control(examine: Examine, context: Context, free_port: int) -> None:
    away = replace(context, lab_recorder_port=free_port)
    assert [each.level for each in examine(away, "services")] == [Level.NOTE]
    with socket.create_server(("127.0.0.1", free_port)):
        assert [each.level for each in examine(away, "services")] == [Level.OK]
    assert checks.lab_recorder(free_port).level is Level.NOTE


def test_devices_are_sorted_by_how_they_are_reached(configured: Configured) -> None:
    text = "".join(
        f"{table.rstrip()}\n"
        for table in (
            POLAR,
            ZEPHYR.format("COM7"),
            ZEPHYR.format("socket://10.0.0.5:7001").replace('"1"', '"2"'),
            E4.format(28000),
            CORTEX.format("wss://localhost", ""),
        )
    )
    devices = configured(text).enabled
    assert [each.sensor for each in checks.by_bluetooth_le(devices)] == ["polar_h10"]
    assert checks.serial_ports_of(devices) == {"COM7": "zephyr"}
    assert [(each.host, each.port) for each in checks.services_of(devices)] == [
        ("10.0.0.5", 7001),
        ("127.0.0.1", 28000),
        ("localhost", 443),
    ]
