"""The installed program serves the page: a browser finds a sensor, adds it, and sees its traces."""

from __future__ import annotations

import re
import time
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect, sync_playwright

from biosensor_gateway.devices.empatica_e4.simulator import SimulatedE4
from biosensor_gateway.simulation.world import World
from installer.wine.prefix import Prefix
from tests.rigs.chromium import OPTIONS
from tests.rigs.windows.pc import WindowsPc
from tests.rigs.windows.program import lively, program_environment
from tests.rigs.wristbands import LOCATED

pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

DEADLINE_S = 90.0
UNIT = "9ff167"
ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+/door\?token=[\w-]+")

expect.set_options(1000 * DEADLINE_S)


@pytest.fixture
def here(installed: WindowsPc, tmp_path: Path) -> Prefix:
    prefix = lively(installed)
    settings = {"BIOSENSOR_GATEWAY_SETTINGS": f"Z:{tmp_path / 'settings.toml'}"}
    return replace(
        prefix, environment={**prefix.environment, **program_environment(tmp_path), **settings}
    )


@pytest.fixture
def chromium() -> Generator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(timeout=1000 * DEADLINE_S, **OPTIONS)
        yield browser
        browser.close()


def test_a_sensor_is_found_added_and_seen(
    here: Prefix, installed: WindowsPc, chromium: Browser, tmp_path: Path
) -> None:
    with World() as world, SimulatedE4(world, device_id=UNIT) as wristband:
        (tmp_path / "settings.toml").write_text(LOCATED.format(**wristband.settings))
        server = here.start(installed.program, "page", "--no-open")
        try:
            assert server.stdout is not None
            begun, said = time.monotonic(), ""
            while (found := ADDRESS.search(said)) is None:
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
