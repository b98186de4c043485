"""How Debian's Chromium is started for tests: without a network, and as root in CI."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, sync_playwright

OPTIONS: dict[str, Any] = {
    "executable_path": os.environ.get("CHROMIUM", "/usr/bin/chromium"),
    "args": [
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
    ],
}


@contextmanager
def chromium() -> Generator[Browser]:
    """Run the browser; without it, skip the test loudly, or fail it in CI.

    Playwright has an event loop running meanwhile, and then the thread can have no other.
    """
    program = Path(OPTIONS["executable_path"])
    if not program.exists():
        missing = f"{program} is missing: install Debian's chromium, or name yours by CHROMIUM"
        assert "CI" not in os.environ, missing
        pytest.skip(f"THE PAGE IS NOT LOOKED AT: {missing}")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(**OPTIONS)
        yield browser
        browser.close()
