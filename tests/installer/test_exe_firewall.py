"""What doctor says of the firewall, whose rules are in the registry."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from installer.layout import PROGRAM
from tests.rigs.windows.desktop import BIN_FOLDER
from tests.rigs.windows.pc import NAME, WindowsPc

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

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
