"""The way of a person who never opens a terminal: from the Start menu's entry to its end."""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect, sync_playwright

from benchmarks import long_recording
from biosensor_gateway.agent.single_instance import LOCK_FILE
from biosensor_gateway.devices.empatica_e4.simulator import SimulatedE4
from biosensor_gateway.recording.export.exporter import FORMATS
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.simulation.world import World
from installer.layout import PROGRAM, WORK
from installer.wine.prefix import Prefix, windows_path
from tests.rigs.chromium import OPTIONS
from tests.rigs.windows.pc import NAME, WindowsPc
from tests.rigs.windows.program import lively, program_environment, read_status
from tests.rigs.windows.registry import BIN_FOLDER
from tests.rigs.wristbands import LOCATED

pytestmark = pytest.mark.system

DEADLINE_S = 120.0
UNIT = "9ff167"
ADDRESS = re.compile(r"--app=(http://127\.0\.0\.1:(\d+)/door\?token=[\w-]+)")
EDGE_KEY = r"HKLM\Software\Microsoft\Windows\CurrentVersion\App Paths\msedge.exe"

expect.set_options(1000 * DEADLINE_S)


@pytest.fixture
def here(installed: WindowsPc, tmp_path: Path) -> Prefix:
    prefix = lively(installed)
    settings = {"BIOSENSOR_GATEWAY_SETTINGS": f"Z:{tmp_path / 'settings.toml'}"}
    return replace(
        prefix, environment={**prefix.environment, **program_environment(tmp_path), **settings}
    )


@pytest.fixture
def asked(here: Prefix) -> Path:
    """What Edge was asked for: Wine has none, so a program in its place writes it down."""
    folder = here.drive_c / "edge"
    folder.mkdir(exist_ok=True)
    (folder / "asked.txt").unlink(missing_ok=True)
    (folder / "msedge.bat").write_text("@echo %*>> C:\\edge\\asked.txt\r\n")
    here.run("reg", "add", EDGE_KEY, "/ve", "/d", r"C:\edge\msedge.bat", "/f")
    return folder / "asked.txt"


@pytest.fixture
def chromium() -> Generator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(timeout=1000 * DEADLINE_S, **OPTIONS)
        yield browser
        browser.close()


def opened(asked: Path, count: int) -> list[tuple[str, str]]:
    """Wait until so many windows were asked for; address and port of each."""
    begun, found = time.monotonic(), list[tuple[str, str]]()
    while len(found) < count:
        assert time.monotonic() < begun + DEADLINE_S, f"{len(found)} windows were opened"
        time.sleep(0.1)
        found = ADDRESS.findall(asked.read_text()) if asked.exists() else []
    return found


def _end(here: Prefix, installed: WindowsPc, program: subprocess.Popen[bytes]) -> None:
    """End what may be left, and close its pipes."""
    for command in (("page", "--end"), ("stop",)):
        here.attempt(installed.program, *command)
    program.kill()
    program.wait()
    for pipe in (program.stdin, program.stdout):
        assert pipe is not None
        pipe.close()


@pytest.mark.timeout(900)
def test_from_the_start_menu_to_traces_and_to_the_end(
    here: Prefix, installed: WindowsPc, asked: Path, chromium: Browser, tmp_path: Path
) -> None:
    with World() as world, SimulatedE4(world, device_id=UNIT) as wristband:
        # Where this computer has the server is all that is known; no sensor is set up.
        (tmp_path / "settings.toml").write_text(LOCATED.format(**wristband.settings))
        program = here.start(installed.windowed)
        try:
            ((address, port),) = opened(asked, 1)
            page = chromium.new_page()
            page.set_default_timeout(1000 * DEADLINE_S)
            page.goto(address)
            page.get_by_role("button", name="Find sensors").first.click()
            entry = page.locator(".found li", has_text=UNIT)
            entry.get_by_label("Participant").fill("p01")
            entry.get_by_role("button", name="Add").click()
            expect(entry.get_by_text("one of your sensors")).to_be_visible()
            page.get_by_role("button", name="Close").click()
            card = page.locator(f'[data-device="empatica_e4/{UNIT.upper()}"]')
            expect(card.get_by_text("streaming")).to_be_visible()
            canvas = card.locator("canvas").first.element_handle()
            page.wait_for_function(
                "([canvas, before]) => canvas.toDataURL() !== before",
                arg=[canvas, canvas and canvas.evaluate("canvas => canvas.toDataURL()")],
            )

            # Nobody has to start an agent again.
            agent = read_status(tmp_path)["process"]
            # Wine's taskkill says that a program has ended as it should.
            here.run(WORK / "python" / "python.exe", "-c", f"import os; os.kill({agent}, 15)")
            expect(page.get_by_text("The agent had died")).to_be_visible()
            expect(card.get_by_text("streaming")).to_be_visible()

            # A second click is a second window, and no second server.
            again = here.attempt(installed.windowed, timeout=DEADLINE_S)
            assert again.returncode == 0, again.stdout
            second = opened(asked, 2)[1]
            assert second[1] == port
            other = chromium.new_page()
            other.set_default_timeout(1000 * DEADLINE_S)
            other.goto(second[0])
            expect(other.get_by_role("button", name="Quit")).to_be_visible()

            page.get_by_role("button", name="Quit").click()
            page.get_by_role("button", name="End everything").click()
            for each in (page, other):
                expect(each.get_by_role("heading", name="The page has ended")).to_be_visible()
            expect(page.get_by_text("The agent has ended.")).to_be_visible()
            assert program.wait(DEADLINE_S) == 0
            assert here.attempt(installed.program, "stop").returncode == 1
            assert not (tmp_path / LOCK_FILE).exists()
        finally:
            _end(here, installed, program)


@pytest.mark.timeout(900)
def test_an_upgrade_closes_the_page_if_it_may(
    here: Prefix, installed: WindowsPc, asked: Path, setup: Path
) -> None:
    program = here.start(installed.windowed)
    try:
        opened(asked, 1)
        refused = here.attempt(setup, "/S")
        assert (refused.returncode, program.poll()) == (3, None), refused.stdout
        upgraded = here.attempt(setup, "/S", "/FORCE=1")
        assert upgraded.returncode == 0, upgraded.stdout
        assert program.wait(DEADLINE_S) == 0
    finally:
        _end(here, installed, program)
    assert installed.windowed.is_file()


PAGE_ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+/door\?token=[\w-]+")

expect.set_options(1000 * DEADLINE_S)


@pytest.mark.timeout(600)
def test_a_sensor_is_found_added_and_seen(
    here: Prefix, installed: WindowsPc, chromium: Browser, tmp_path: Path
) -> None:
    with World() as world, SimulatedE4(world, device_id=UNIT) as wristband:
        (tmp_path / "settings.toml").write_text(LOCATED.format(**wristband.settings))
        server = here.start(installed.program, "page", "--no-open")
        try:
            assert server.stdout is not None
            begun, said = time.monotonic(), ""
            while (found := PAGE_ADDRESS.search(said)) is None:
                assert time.monotonic() < begun + DEADLINE_S, said
                said += server.stdout.readline().decode(errors="replace")
            page = chromium.new_page()
            page.set_default_timeout(1000 * DEADLINE_S)
            page.goto(found[0])
            page.get_by_role("button", name="Find sensors").first.click()
            entry = page.locator(".found li", has_text=UNIT)
            entry.get_by_label("Participant").fill("p01")
            entry.get_by_role("button", name="Add").click()
            expect(entry.get_by_text("one of your sensors")).to_be_visible()
            card = page.locator(f'[data-device="empatica_e4/{UNIT.upper()}"]')
            expect(card.get_by_text("streaming")).to_be_visible()
            canvas = card.locator("canvas").first.element_handle()
            page.wait_for_function(
                "([canvas, before]) => canvas.toDataURL() !== before",
                arg=[canvas, canvas and canvas.evaluate("canvas => canvas.toDataURL()")],
            )
            ended = here.attempt(installed.program, "stop")
            assert ended.returncode == 0, ended.stdout
            expect(page.get_by_text("agent does not run")).to_be_visible()
        finally:
            here.attempt(installed.program, "stop")
            server.kill()
            server.wait()
            for pipe in (server.stdin, server.stdout):
                assert pipe is not None
                pipe.close()


RECORDED_S = 10.0


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "Aufnahme für p01.xdf"
    long_recording.write(path, RECORDED_S, long_recording.of_a_lab())
    return path


def _samples(path: Path) -> dict[str, int]:
    return {each.header.source_id: each.sample_count for each in read_recording(path).streams}


@pytest.mark.timeout(600)
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
ALLOWED = "the firewall allows this program"


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


@pytest.mark.timeout(600)
def test_rules_are_judged_by_what_they_do(installed: WindowsPc) -> None:
    assert said(installed) == ["note: the rules of Windows' firewall cannot be read"]
    add(installed, "{1}", OURS.replace(EXE, rf"D:\old\{PROGRAM}.exe"))
    (found,) = said(installed)
    assert found.endswith(rf"is for D:\old\{PROGRAM}.exe")
    add(installed, "{1}", OURS)
    assert said(installed) == [f"ok: {ALLOWED}: {NAME!r}"]
    add(installed, "UDP Query User{2}", CANCELLED)
    assert said(installed) == ["warning: the firewall's rule 'asked' blocks UDP to this program"]
