"""The installed program writes recordings in every format, and makes a recording of a bag."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import long_recording
from biosensor_gateway.recording.export.exporter import FORMATS
from biosensor_gateway.recording.xdf.recording import read_recording
from installer.layout import PROGRAM
from installer.wine.prefix import windows_path
from tests.rigs.windows.desktop import BIN_FOLDER
from tests.rigs.windows.pc import NAME, WindowsPc

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

RECORDED_S = 10.0


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "Aufnahme für p01.xdf"
    long_recording.write(path, RECORDED_S, long_recording.of_a_lab())
    return path


def _samples(path: Path) -> dict[str, int]:
    return {each.header.source_id: each.sample_count for each in read_recording(path).streams}


def test_every_format_is_written_and_a_bag_is_a_recording_again(
    installed: WindowsPc, recording: Path, tmp_path: Path
) -> None:
    for name in FORMATS:
        place = tmp_path / name
        place.mkdir()
        line = ("xdf", "export", windows_path(recording), "--to", name)
        ended = installed.gateway(*line, "--output", windows_path(place))
        assert ended.returncode == 0, (name, ended.stdout)
        assert any(each.stat().st_size for each in place.rglob("*") if each.is_file()), name
    (bag,) = (tmp_path / "mcap").iterdir()
    again = tmp_path / "again.xdf"
    ended = installed.gateway("bag", "import", windows_path(bag), "--output", windows_path(again))
    assert ended.returncode == 0, ended.stdout
    assert _samples(again) == _samples(recording)


# What doctor says of the firewall, whose rules are in the registry.

KEY = (
    r"HKEY_LOCAL_MACHINE\SYSTEM\CurrentControlSet\Services\SharedAccess\Parameters"
    r"\FirewallPolicy\FirewallRules"
)
EXE = rf"{BIN_FOLDER}\{PROGRAM}.exe"
OURS = rf"v2.31|Action=Allow|Active=TRUE|Dir=In|Profile=Private|App={EXE}|Name={NAME}|"
CANCELLED = rf"v2.31|Action=Block|Active=TRUE|Dir=In|Protocol=17|App={EXE}|Name=asked|"
ALLOWED = "the firewall lets this program in"


def add(pc: WindowsPc, name: str, rule: str) -> None:
    # From a file, because Wine would put backslashes before the quotes of an argument.
    file: Path = pc.drive_c / "rule.reg"
    value = rule.replace("\\", "\\\\")
    file.write_text(f'REGEDIT4\r\n\r\n[{KEY}]\r\n"{name}"="{value}"\r\n')
    pc.prefix.run("regedit", "/S", r"C:\rule.reg")


def said(pc: WindowsPc) -> list[str]:
    ended = pc.gateway("doctor", "--only", "windows_firewall", "--json")
    found = json.loads(ended.stdout)["findings"]
    return [f"{each['level']}: {each['what']}" for each in found if "network" not in each["what"]]


def test_rules_are_judged_by_what_they_do(installed: WindowsPc) -> None:
    assert said(installed) == ["note: the rules of Windows' firewall cannot be read"]
    add(installed, "{1}", OURS.replace(EXE, rf"D:\old\{PROGRAM}.exe"))
    (found,) = said(installed)
    assert found.endswith(rf"is for D:\old\{PROGRAM}.exe")
    add(installed, "{1}", OURS)
    assert said(installed) == [f"ok: {ALLOWED}: {NAME!r}"]
    add(installed, "UDP Query User{2}", CANCELLED)
    assert said(installed) == ["warning: the firewall's rule 'asked' blocks UDP to this program"]
