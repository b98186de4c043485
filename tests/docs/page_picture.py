"""``python -m tests.docs.page_picture FOLDER``: pictures of the page from a real run."""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import uuid
from pathlib import Path
from typing import Literal, get_args

from playwright.sync_api import Browser, expect, sync_playwright

from tests.rigs.chromium import OPTIONS

Scheme = Literal["light", "dark"]
SECONDS = 15
"""Until traces fill their window, and devices have told their battery."""
_ADDRESS = re.compile(r"http://\S+")


def _take(browser: Browser, address: str, folder: Path) -> None:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    page.goto(address)
    expect(page.locator(".card", has_text="streaming")).to_have_count(7, timeout=60_000)
    page.wait_for_timeout(1000 * SECONDS)
    for scheme in get_args(Scheme):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(500)
        name = "page.png" if scheme == "light" else f"page-{scheme}.png"
        page.screenshot(path=folder / name)
    page.get_by_role("button", name="Traces and details of Polar H10").click()
    page.wait_for_timeout(2000)
    page.emulate_media(color_scheme="light")
    page.screenshot(path=folder / "page-detail.png")
    context.close()


def main() -> None:
    """Run agent and page, and take the pictures."""
    parser = argparse.ArgumentParser(description="Take pictures of the page from a real run.")
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    cli = [sys.executable, "-m", "biosensor_gateway.cli"]
    with tempfile.TemporaryDirectory() as state:
        # What is on the picture must not name the computer.
        os.environ["BIOSENSOR_GATEWAY_STATE"] = state
        os.environ["BIOSENSOR_GATEWAY_LSL__SESSION_ID"] = f"pictures-{uuid.uuid4().hex}"
        settings = ["--settings", "settings.toml"]
        page = subprocess.Popen([*cli, "page", "--no-open", *settings], stdout=subprocess.PIPE)
        agent = subprocess.Popen([*cli, "run", "--simulate", "all"], stderr=subprocess.DEVNULL)
        try:
            assert page.stdout is not None
            found = _ADDRESS.search(page.stdout.readline().decode())
            assert found is not None
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(**OPTIONS)
                _take(browser, found[0], options.folder)
                browser.close()
        finally:
            for process in (agent, page):
                process.terminate()
                process.wait(30)


if __name__ == "__main__":
    main()
