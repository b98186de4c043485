"""What is not passed on as it came stands on the card, in the details and on the network's page."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Programs, Server
from tests.page.test_network_reading import other_streams

pytestmark = pytest.mark.nightly

AGENT = "run --no-ask --features --simulate ble_heart_rate --fault repeat:90s@2s"
SKIN = {"name": "Skin", "type": "GSR", "rate": 100.0, "source_id": "electrodes", "unit": ""}
REPEATED = re.compile(r"ibi: \d+ samples were not sent: intervals between beats add up to more")

expect.set_options(1000 * DEADLINE_S)


def test_it_stands_where_a_person_looks(
    server: Server, window: Callable[..., Page], programs: Programs
) -> None:
    programs.start(*AGENT.split())
    with other_streams([SKIN]):
        page = window()
        page.goto(server.address)
        card = page.locator('.card[data-device^="ble_heart_rate"]')
        expect(card.locator(".refused")).to_contain_text(REPEATED)
        expect(card.locator(".card-head .state.warn")).to_contain_text("not all as it came")
        own = page.locator(".panel", has_text="Not all is passed on as it came")
        expect(own).to_contain_text("live features of Skin: stream 'Skin' has no unit")
        assert not violations(page)
        card.get_by_role("button", name="Traces and details").click()
        expect(page.locator(".panel .refused", has_text=REPEATED)).to_be_visible()
        assert "Skin" in programs.call("status")

        network = Server(programs, "--lsl")
        other = window()
        other.goto(network.address)
        seen = other.locator(".card", has_text="heart rate")
        expect(seen.locator(".note").first).to_contain_text(REPEATED)
