"""``biosensor-gateway scan``: what it finds, how to add it, and where it could not look."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from biosensor_gateway.devices.ble_heart_rate.simulator import SimulatedHeartRateStrap
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.emotiv_insight.simulator import (
    Circumstances,
    SimulatedCortex,
    Timing,
)
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.registry import (
    declaration,
    driver,
    sensor_names,
    settings_models,
)
from biosensor_gateway.doctor import scan as search
from biosensor_gateway.settings.file import load_settings
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from tests.rigs.gateway import cli_process
from tests.rigs.lab_client import LabProcess, settings_toml
from tests.rigs.polling import wait_until

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

Run = Callable[..., "Outcome"]

STRAPS = {
    "polar_h10": {"unit": "A1B2C3D4", "device": "A0:9E:1A:A1:B2:C3"},
    "vernier_respiration_belt": {"unit": "0K2002Z5", "device": "E0:F5:BD:94:6A:1B"},
    "ble_heart_rate": {"unit": "C8:25:00:00:00:01", "device": "C8:25:00:00:00:01"},
}
FOUND = (*STRAPS, "emotiv_insight", "empatica_e4")
BLUETOOTH, SERIAL = "Bluetooth LE", "Serial ports"
CORTEX, E4_SERVER = "Emotiv Insight by its service", "Empatica E4 by its service"
QUICK = Timing(found_s=0.05, scan_s=0.3, connect_s=0.05)


@pytest.fixture(autouse=True)
def no_secrets(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("EMOTIV_CLIENT_ID", "EMOTIV_CLIENT_SECRET"):
        monkeypatch.delenv(variable, raising=False)


def sections(outcome: Outcome) -> dict[str, dict[str, Any]]:
    assert (outcome.code, outcome.err) == (0, "")
    return {section["where"]: section for section in json.loads(outcome.out)}


def settings_of(section: dict[str, Any]) -> dict[str, Any]:
    return {found["sensor"]: found["settings"] for found in section["found"]}


def lines_about(outcome: Outcome, title: str) -> list[str]:
    return [line for line in outcome.out.splitlines() if line.startswith(f"{title}: ")]


@pytest.mark.nightly
def test_for_scripts_it_is_json_of_one_form(run: Run) -> None:
    found = sections(run("scan", "--simulate", ",".join(STRAPS), "--seconds", "2", "--json"))
    services = [declaration(name).title for name in sensor_names() if driver(name).find is not None]
    assert {CORTEX, E4_SERVER} <= found.keys()
    assert list(found) == [BLUETOOTH, SERIAL, *(f"{title} by its service" for title in services)]
    for section in found.values():
        assert section.keys() == {"where", "problem", "others", "advice", "found"}
        assert section["problem"] is None or not (section["found"] or section["others"])
        for device in section["found"]:
            assert device.keys() == {
                *("sensor", "title", "name", "rssi_dbm", "settings", "toml", "is_known")
            }
            (table,) = tomllib.loads(device["toml"])["device"]
            assert table == {"sensor": device["sensor"], **device["settings"]}
    assert found[BLUETOOTH]["problem"] is None
    assert settings_of(found[BLUETOOTH]) == STRAPS
    strengths = [device["rssi_dbm"] for device in found[BLUETOOTH]["found"]]
    assert strengths == sorted(strengths, reverse=True)
    assert all(-127 < strength < 0 for strength in strengths)


@pytest.mark.nightly
def test_for_people_it_shows_the_lines_that_the_settings_file_takes(
    run: Run, settings: Path
) -> None:
    outcome = run("scan", "--simulate", ",".join(STRAPS), "--seconds", "2")
    assert (outcome.code, outcome.err) == (0, "")
    assert f"{BLUETOOTH}: 3 found" in outcome.out
    assert "  Polar H10 A1B2C3D4, -58 dBm\n" in outcome.out
    shown = [line for line in outcome.out.splitlines() if line.startswith("    ") or not line]
    assert run("config", "init").code == 0
    with settings.open("a") as file:
        file.write(textwrap.dedent("\n".join(shown)))
    loaded = load_settings(settings, settings_models())
    assert {each.sensor: each.unit for each in loaded.devices} == {
        sensor: fields["unit"] for sensor, fields in STRAPS.items()
    }


@pytest.mark.nightly
def test_what_no_driver_knows_is_named(run: Run, world: World, radio: Radio) -> None:
    lamp = Peripheral(radio, "A0:9E:1A:00:00:01", "Lamp", rssi_dbm=-61)
    world.await_(lamp.power_on([]))
    outcome = run("scan", "--seconds", "2")
    assert lines_about(outcome, BLUETOOTH) == [f"{BLUETOOTH}: nothing that any driver knows"]
    assert "  not known to any driver: Lamp (A0:9E:1A:00:00:01, -61 dBm)\n" in outcome.out


@pytest.mark.nightly
def test_two_of_a_kind_are_two_devices(run: Run, world: World, radio: Radio) -> None:
    with (
        SimulatedPolarH10(world, radio, address="A0:9E:1A:00:00:01", device_id="AAAA0001"),
        SimulatedPolarH10(world, radio, address="A0:9E:1A:00:00:02", device_id="BBBB0002"),
    ):
        found = sections(run("scan", "--seconds", "2", "--json"))[BLUETOOTH]["found"]
    assert {device["settings"]["unit"] for device in found} == {"AAAA0001", "BBBB0002"}


@pytest.mark.nightly
def test_two_of_a_name_are_told_apart_by_address(run: Run, world: World, radio: Radio) -> None:
    name, addresses = "Strap", ("C8:25:00:00:00:01", "C8:25:00:00:00:02")
    with (
        SimulatedHeartRateStrap(world, radio, address=addresses[0], name=name),
        SimulatedHeartRateStrap(world, radio, address=addresses[1], name=name),
    ):
        outcome = run("scan", "--seconds", "2")
    assert all(f'device = "{each}"' in outcome.out for each in addresses)
    assert (
        f"  2 have the name {name}: only the address under `device` distinguishes them. Hold one "
        "close to this computer and scan again: the nearest comes first.\n"
    ) in outcome.out


def test_macos_has_identifiers_that_hold_for_one_computer() -> None:
    identifier = "6F8D4C1E-0B7A-4D3C-9E52-1A2B3C4D5E6F"
    strap = Found("polar_h10", "Strap", {"unit": "1", "device": identifier})
    address = Found("polar_h10", "Strap", {"unit": "2", "device": "C8:25:00:00:00:01"})
    (sentence,) = search.place_of(BLUETOOTH, (strap,), ()).advice
    assert sentence.startswith("macOS shows identifiers instead of addresses: another computer")
    assert search.place_of(BLUETOOTH, (address,), ()).advice == []


def test_what_the_settings_have_by_now_is_known() -> None:
    strap = Found("polar_h10", "Strap", {"unit": "1", "device": "C8:25:00:00:00:01"})
    place = search.place_of(BLUETOOTH, (strap,), ())
    (found,) = place.found
    for configured in ((), (DeviceSettings(sensor="polar_h10", unit="1"),), ()):
        search.mark_known([place], configured)
        assert found.is_known == bool(configured)


@pytest.mark.nightly
def test_a_radio_that_is_off_is_one_line(run: Run, world: World, radio: Radio) -> None:
    with SimulatedPolarH10(world, radio):
        radio.available = False
        outcome = run("scan", "--seconds", "2")
        assert outcome.code == 0
        (line,) = lines_about(outcome, BLUETOOTH)
        assert "switch" in line
        found = sections(run("scan", "--seconds", "2", "--json"))
    assert found[BLUETOOTH]["found"] == []
    assert f"{BLUETOOTH}: {found[BLUETOOTH]['problem']}" == line


@pytest.mark.nightly
def test_what_a_service_lacks_is_one_line_each(run: Run, radio: Radio) -> None:
    outcome = run("scan", "--seconds", "1")
    assert (outcome.code, outcome.err) == (0, "")
    (cortex,) = lines_about(outcome, CORTEX)
    assert "EMOTIV_CLIENT_ID" in cortex
    (server,) = lines_about(outcome, E4_SERVER)
    assert "28000" in server


@pytest.mark.nightly
def test_a_headset_is_found_where_the_settings_say_that_its_service_is(
    run: Run, world: World, radio: Radio, settings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SimulatedCortex(
        world, Circumstances(neighbours=("INSIGHT-00000002",)), timing=QUICK
    ) as cortex:
        for variable, text in cortex.environment.items():
            monkeypatch.setenv(variable, text)
        settings.parent.mkdir()
        place = {name: cortex.settings[name] for name in ("url", "ca_file")}
        lines = [f"{name} = {json.dumps(value)}" for name, value in place.items()]
        header = '[[device]]\nsensor = "emotiv_insight"\nunit = "mine"\n'
        settings.write_text(header + "\n".join(lines))
        outcome = run("scan", "--seconds", "1", "--json")
        found = sections(outcome)[CORTEX]
    assert cortex.client_secret not in outcome.out
    assert {device["settings"]["headset"] for device in found["found"]} == {
        cortex.settings["headset"],
        "INSIGHT-00000002",
    }
    for device in found["found"]:
        assert place.items() <= device["settings"].items()
        settings.write_text(device["toml"])
        assert len(load_settings(settings, settings_models()).devices) == 1


@pytest.mark.nightly
def test_a_search_that_breaks_ends_no_other(
    run: Run, radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def broken() -> list[Any]:
        raise RuntimeError("boom")

    monkeypatch.setattr(search, "serial_ports", broken)
    outcome = run("scan", "--seconds", "1")
    assert outcome.code == 0
    assert lines_about(outcome, SERIAL) == [f"{SERIAL}: the search failed (RuntimeError)"]
    assert len(lines_about(outcome, BLUETOOTH)) == 1
    assert outcome.err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "text", "words"),
    [
        ((), "[lsl\n", "not valid TOML"),
        ((), '[[device]]\nsensor = "zephir"\nunit = "1"\n', "zephir"),
        (("--settings", "nowhere.toml"), "", "nowhere.toml"),
        (("--simulate", "toaster"), "", "toaster"),
    ],
)
def test_a_wrong_command_or_file_is_said_before_anything_is_searched(
    run: Run, settings: Path, arguments: tuple[str, ...], text: str, words: str
) -> None:
    settings.parent.mkdir()
    settings.write_text(text)
    outcome = run("scan", *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert words in outcome.err


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabProcess]:
    devices = [{"key": sensor, "sensor": sensor} for sensor in FOUND]
    with LabProcess(devices, tmp_path_factory.mktemp("lab")) as running:
        yield running


@pytest.mark.nightly
def test_an_agent_connects_to_all_that_was_found(
    lab: LabProcess,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for variable, text in lab.environment.items():
        monkeypatch.setenv(variable, text)
    settings = tmp_path / "settings.toml"
    services = {sensor: sensor for sensor in FOUND if sensor not in STRAPS}
    settings.write_text(settings_toml(lab, services))
    command = [sys.executable, "-m", "biosensor_gateway.cli", "scan", "--json", "--settings"]
    scanned = subprocess.run([*command, str(settings)], capture_output=True, check=True)
    assert scanned.stderr == b""
    found = [device for section in json.loads(scanned.stdout) for device in section["found"]]
    assert sorted(device["sensor"] for device in found) == sorted(FOUND)

    settings.write_text("\n\n".join(device["toml"] for device in found))
    status = tmp_path / "status.json"

    def states() -> list[str]:
        devices: list[dict[str, Any]] = json.loads(status.read_text())["devices"]
        return [device["state"] for device in devices]

    with cli_process(tmp_path, "run", "--settings", str(settings)):
        wait_until(lambda: status.exists() and states() == ["streaming"] * len(found))


LISTENING = """
from biosensor_gateway import cli
from biosensor_gateway.doctor import scan

listen = scan.scan_bluetooth

def told(seconds):
    print("listening", flush=True)
    return listen(seconds)

scan.scan_bluetooth = told
cli.main()
"""


@pytest.mark.nightly
def test_ctrl_c_ends_a_scan_without_a_traceback(lab: LabProcess) -> None:
    command = [sys.executable, "-c", LISTENING, "scan", "--seconds", "60"]
    process = subprocess.Popen(
        command, env=os.environ | lab.environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"listening\n"
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode > 0
    assert b"Traceback" not in out + err
