"""One server for each state folder: a second start opens its page, and either ends as it should."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Generator
from pathlib import Path

import psutil
import pytest
from playwright.sync_api import Browser, Page, expect

from biosensor_gateway.page.instance import ADDRESS, ask_for_window, page_folder
from tests.page.conftest import DEADLINE_S, STARTED, Programs, Server
from tests.rigs.chromium import OPTIONS
from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly

expect.set_options(1000 * DEADLINE_S)
OpenWindow = Callable[..., Page]
NO_SENSOR = "No sensor is set up yet"
# Minutes.
SOON = "0.05"


@pytest.mark.seam
def test_a_second_start_opens_another_window_of_the_same_server(
    server: Server, window: OpenWindow
) -> None:
    page = window()
    page.goto(server.address)
    said = server.programs.call("page", "--no-open")
    found = STARTED.search(said)
    assert found is not None
    assert int(found[1]) == server.port
    # What opens the page without a browser of ours lies in no file, and is another one each time.
    assert found[0] != server.address
    token = found[0].rpartition("=")[2].encode()
    files = [each for each in server.programs.folder.rglob("*") if each.is_file()]
    assert not [each for each in files if token in each.read_bytes()]
    control = page_folder(server.programs.folder) / "control.json"
    assert control.stat().st_mode & 0o077 == 0
    second = window()
    second.goto(found[0])
    for each in (page, second):
        expect(each.get_by_role("heading", name=NO_SENSOR)).to_be_visible()


def test_of_two_that_start_at_once_one_serves_and_the_other_opens_it(programs: Programs) -> None:
    both = [programs.start("page", "--no-open", stdout=subprocess.PIPE) for _ in range(2)]
    ports: set[str] = set()
    for each in both:
        assert each.stdout is not None
        found = STARTED.search(each.stdout.readline().decode())
        assert found is not None
        ports.add(found[1])
    assert len(ports) == 1
    wait_until(
        lambda: [each.poll() for each in both].count(0) == 1, "one that has opened the other's"
    )
    assert [each.poll() for each in both].count(None) == 1


def test_other_settings_are_not_shown_as_if_they_were_those_asked_for(server: Server) -> None:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "page", "--settings", "other.toml"]
    environment = server.programs.environment
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert f"with the settings file {server.programs.settings}; end it first" in ended.stderr


def test_a_server_that_was_killed_is_in_nobodys_way(programs: Programs) -> None:
    killed = Server(programs)
    killed.process.kill()
    killed.process.wait()
    assert Server(programs).request("GET", "/", "").status == 401


def test_it_serves_where_nothing_can_be_written_and_says_what_that_means(
    programs: Programs,
) -> None:
    page_folder(programs.folder).write_text("no folder")
    assert Server(programs).request("GET", "/", "").status == 401
    said = programs.folder / "stderr-0.txt"
    expected = "a second page would be a second server"
    wait_until(lambda: expected in said.read_text(), expected)


def test_a_time_that_is_none_is_refused_in_one_sentence(programs: Programs) -> None:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "page", "--end-after", "nan"]
    ended = subprocess.run(
        command, env=programs.environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2
    assert "nan is not a time; give minutes, such as 2" in " ".join(ended.stderr.split())


def test_it_is_ended_by_a_command_and_its_windows_say_so(
    server: Server, window: OpenWindow
) -> None:
    page = window()
    page.goto(server.address)
    expect(page.get_by_role("heading", name=NO_SENSOR)).to_be_visible()
    assert server.programs.call("page", "--end") == "the page has ended\n"
    assert server.process.wait(DEADLINE_S) == 0
    expect(page.get_by_role("heading", name="The page has ended")).to_be_visible()


# A page with a thread that never comes back, as one that waits in liblsl; it may take a second.
NEVER_ENDS = """
import threading
from biosensor_gateway.page import pages
from biosensor_gateway.cli import main
pages.ENDS_WITHIN_S = 1.0
threading.Thread(target=threading.Event().wait).start()
main()
"""


def test_one_that_hangs_ends_all_the_same(programs: Programs) -> None:
    command = [sys.executable, "-c", NEVER_ENDS, "page", "--no-open"]
    hanging = subprocess.Popen(command, env=programs.environment, stdout=subprocess.PIPE)
    with hanging:
        assert hanging.stdout is not None
        assert STARTED.search(hanging.stdout.readline().decode())
        assert programs.call("page", "--end") == "the page has ended\n"
        try:
            assert hanging.wait(DEADLINE_S / 2) == 0
        finally:
            hanging.kill()


def test_it_ends_after_its_last_window_but_not_while_an_agent_runs(
    programs: Programs, window: OpenWindow
) -> None:
    server = Server(programs, "--end-after", SOON)
    page = window()
    page.goto(server.address)
    expect(page.get_by_role("heading", name=NO_SENSOR)).to_be_visible()
    programs.start("run", "--simulate", "zephyr")
    expect(page.locator(".card", has_text="streaming")).to_have_count(1)
    page.close()
    with pytest.raises(subprocess.TimeoutExpired):
        server.process.wait(2 * 60 * float(SOON))
    programs.call("stop")
    assert server.process.wait(DEADLINE_S) == 0


# What a browser was given to open: its contents, and who may read it and look into its folder.
LOOK = """file=$(echo "$1" | sed 's/^--app=//; s,^file://,,')
cat "$file" > "{0}"
stat -c %a "$file" "$(dirname "$file")" >> "{0}"
"""


@pytest.fixture
def profile(programs: Programs, tmp_path: Path) -> Generator[Path]:
    """Let a real Chromium be the browser of the programs; where it says what it was asked for."""
    folder, profile = tmp_path / "bin", tmp_path / "profile"
    folder.mkdir()
    program = folder / "chromium"
    options = " ".join([*OPTIONS["args"], "--headless=new", "--remote-debugging-port=0"])
    program.write_text(
        f'#!/bin/sh\necho "$@" > "{tmp_path}/asked"\n{LOOK.format(tmp_path / "file")}'
        f'exec "{OPTIONS["executable_path"]}" {options} --user-data-dir="{profile}" "$@"\n'
    )
    program.chmod(0o755)
    programs.variables["PATH"] = f"{folder}:{os.environ['PATH']}"
    yield profile
    for process in psutil.process_iter(["cmdline"]):
        if f"--user-data-dir={profile}" in (process.info["cmdline"] or []):
            process.kill()


def page_titles(address: str) -> list[str]:
    """Ask a browser for the titles of its pages."""
    with urllib.request.urlopen(f"{address}/json/list", timeout=DEADLINE_S) as answer:
        return [each["title"] for each in json.load(answer) if each["type"] == "page"]


def test_it_opens_a_window_of_its_own_and_ends_after_it(
    programs: Programs, profile: Path, tmp_path: Path, chromium: Browser
) -> None:
    server = programs.start("page", "--window", "--end-after", SOON)
    port = profile / "DevToolsActivePort"
    wait_until(lambda: port.exists() and port.read_text(), "a browser")
    # Any user of the computer sees what stands on a command line.
    asked = (tmp_path / "asked").read_text()
    assert asked.startswith("--app=file:///")
    assert "token" not in asked
    seen = (tmp_path / "file").read_text()
    assert STARTED.search(seen)
    assert seen.split()[-2:] == ["600", "700"]
    address = f"http://127.0.0.1:{port.read_text().split()[0]}"
    # Who connects while the window is being made may wait for ever.
    wait_until(lambda: "Biosensor Gateway" in page_titles(address), "the page in a window")
    opened = chromium.browser_type.connect_over_cdp(address)
    (page,) = opened.contexts[0].pages
    expect(page.get_by_role("heading", name=NO_SENSOR)).to_be_visible()
    assert not Path(asked.split()[0].removeprefix("--app=file://")).parent.exists()
    page.close()
    assert server.wait(DEADLINE_S) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_what_a_browser_has_not_opened_is_removed_with_the_page(
    programs: Programs, tmp_path: Path, number: signal.Signals
) -> None:
    browser = tmp_path / "usual-browser"
    browser.write_text(
        f'#!/bin/sh\n{LOOK.format(tmp_path / "file")}echo "$1" > "{tmp_path}/asked"\n'
    )
    browser.chmod(0o755)
    programs.variables["BROWSER"] = f"{browser} %s"
    server = programs.start("page")
    asked = tmp_path / "asked"
    wait_until(lambda: asked.exists() and asked.read_text(), "a browser")
    file = Path(asked.read_text().strip().removeprefix("file://"))
    assert STARTED.search((tmp_path / "file").read_text())
    assert file.exists()
    # That of a second start is the running page's, too.
    asked.unlink()
    programs.call("page")
    second = Path(asked.read_text().strip().removeprefix("file://"))
    assert second != file
    assert second.exists()
    server.send_signal(number)
    assert server.wait(DEADLINE_S) == 0
    assert not file.parent.exists()
    assert not second.parent.exists()


WINDOWED = [sys.executable, "-m", "biosensor_gateway.system.windowed"]


def test_the_windowed_program_says_why_no_window_could_be_opened(
    programs: Programs, tmp_path: Path
) -> None:
    # Neither a browser nor a terminal for one.
    nothing = {"PATH": str(tmp_path / "none"), "BROWSER": "", "DISPLAY": "", "TERM": "dumb"}
    ended = subprocess.run(
        WINDOWED, env=programs.environment | nothing, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1
    assert "Biosensor Gateway: The page has ended: no browser could be opened" in ended.stderr
    assert str(page_folder(programs.folder)) in ended.stderr
    log = page_folder(programs.folder) / "biosensor-gateway.log"
    assert "no browser could be opened" in log.read_text()


@pytest.mark.usefixtures("profile")
def test_the_windowed_program_says_that_its_page_was_killed(programs: Programs) -> None:
    launcher = subprocess.Popen(
        WINDOWED, env=programs.environment, stderr=subprocess.PIPE, text=True
    )
    control = page_folder(programs.folder) / "control.json"
    wait_until(control.exists, "a server")
    (server,) = psutil.Process(launcher.pid).children()
    server.kill()
    _, said = launcher.communicate(timeout=DEADLINE_S)
    assert launcher.returncode != 0
    assert "The page has ended: exit code -9" in said


def test_run_opens_the_page_beside_it(programs: Programs, window: OpenWindow) -> None:
    programs.environment_more["BROWSER"] = "true"
    running = programs.start("run", "--page", "--simulate", "zephyr")
    wait_until(lambda: ask_for_window(programs.folder), "a page")
    opened = ask_for_window(programs.folder)
    assert opened is not None
    page = window()
    page.goto(opened[ADDRESS])
    expect(page.locator(".card", has_text="streaming")).to_have_count(1)
    running.send_signal(signal.SIGINT)
    assert running.wait(DEADLINE_S) == 0
    expect(page.get_by_text("agent does not run")).to_be_visible()
    assert "the page has ended" in programs.call("page", "--end")
