"""``python -m tests.docs.page_picture FOLDER``: pictures of the page from a real run."""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, get_args

from playwright.sync_api import Browser, expect, sync_playwright

from biosensor_gateway.demo.virtual_devices import one_of_each
from tests.rigs.chromium import OPTIONS

Scheme = Literal["light", "dark"]
SECONDS = 15
"""Until traces fill their window, and devices have told their battery."""
HOST = "lab-pc"
DEVICES = len(one_of_each())
SENSORS = "empatica_e4,polar_h10,zephyr"
"""Beside other programs' streams; more would push those out of the picture."""
OTHERS: list[dict[str, Any]] = [
    {"name": "amplifier", "rate": 250.0, "channels": 32, "waves": True},
    {"name": "experiment", "type": "Markers", "format": "string", "text": "trial {}"},
    {"name": "microphone", "type": "Audio", "rate": 44_100.0, "unit": "normalized", "waves": True},
]
_LSL = "[lab]\nSessionID = pictures-{}\nKnownPeers = {{127.0.0.1}}\n[ports]\nPortRange = 256\n"
# What is on the picture must not name the computer.
_NAMED = ["unshare", "--map-root-user", "--uts", "sh", "-c", f'hostname {HOST}; exec "$@"', "sh"]
_ADDRESS = re.compile(r"http://\S+")


def _take(browser: Browser, address: str, folder: Path) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.goto(address)
    expect(page.locator(".card", has_text="streaming")).to_have_count(DEVICES, timeout=60_000)
    page.wait_for_timeout(1000 * SECONDS)
    for scheme in get_args(Scheme):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(500)
        name = "page.png" if scheme == "light" else f"page-{scheme}.png"
        page.screenshot(path=folder / name)
    page.get_by_role("button", name="Traces and details of Polar H10").click()
    page.wait_for_timeout(2000)
    page.emulate_media(color_scheme="light")
    # Not the whole page: below stands where this computer has its settings.
    page.locator("main").screenshot(path=folder / "page-detail.png")
    context.close()


def _take_network(browser: Browser, address: str, folder: Path) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 1020})
    page = context.new_page()
    page.goto(address)
    expect(page.locator(".card", has_text="trial")).to_be_visible(timeout=60_000)
    page.wait_for_timeout(1000 * SECONDS)
    page.screenshot(path=folder / "page-lsl.png")
    context.close()


def _record(cli: list[str], recording: Path) -> None:
    """Record what streams now."""
    start = ["record", "start", "--here", "--all", "--file", str(recording)]
    subprocess.run([*cli, *start], check=True)
    time.sleep(SECONDS)
    subprocess.run([*cli, "record", "stop"], check=True)


def _take_replay(browser: Browser, address: str, recording: Path, folder: Path) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.goto(address)
    page.get_by_role("banner").get_by_role("button", name="Play a recording").click()
    panel = page.get_by_role("region", name="Play a recording")
    panel.get_by_label("Recording").select_option("another file …")
    panel.get_by_label("full path").fill(str(recording))
    panel.get_by_role("button", name="Play", exact=True).click(timeout=60_000)
    expect(page.locator(".card.replay")).to_have_count(DEVICES, timeout=60_000)
    panel.get_by_role("button", name="Close").click()
    page.wait_for_timeout(1000 * (SECONDS - 3))
    page.screenshot(path=folder / "page-replay.png")
    context.close()


def _address(page: subprocess.Popen[bytes]) -> str:
    assert page.stdout is not None
    found = _ADDRESS.search(page.stdout.readline().decode())
    assert found is not None
    return found[0]


@contextmanager
def _running(*commands: list[str]) -> Generator[subprocess.Popen[bytes]]:
    """Run programs, of which the first says where it is."""
    processes = [
        subprocess.Popen(each, stdout=subprocess.PIPE if i == 0 else subprocess.DEVNULL)
        for i, each in enumerate(commands)
    ]
    try:
        yield processes[0]
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(30)


def main() -> None:
    """Run agent and page, and take the pictures."""
    parser = argparse.ArgumentParser(description="Take pictures of the page from a real run.")
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    cli = [sys.executable, "-m", "biosensor_gateway.cli"]
    run = [*_NAMED, *cli, "run", "--simulate"]
    page = [*cli, "page", "--no-open", "--settings", "settings.toml"]
    others = [*_NAMED, sys.executable, "-m", "tests.page.other_streams", json.dumps(OTHERS)]
    with tempfile.TemporaryDirectory() as state, sync_playwright() as playwright:
        os.environ["BIOSENSOR_GATEWAY_STATE"] = state
        os.environ["XDG_DOCUMENTS_DIR"] = "/home/lab/Documents"
        recording = Path(state) / "study.xdf"
        lsl = Path(state) / "lsl_api.cfg"
        lsl.write_text(_LSL.format(uuid.uuid4().hex))
        os.environ["LSLAPICFG"] = str(lsl)
        browser = playwright.chromium.launch(**OPTIONS)
        with _running([*page, "--lsl"], [*run, SENSORS], others) as network:
            _take_network(browser, _address(network), folder)
        with _running(page, [*run, "all"]) as agent:
            _take(browser, _address(agent), folder)
            _record(cli, recording)
        with _running(page) as player:
            _take_replay(browser, _address(player), recording, folder)
        browser.close()


if __name__ == "__main__":
    main()
