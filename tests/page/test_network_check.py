"""The network to another computer, tried from the page; both computers are this one."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from playwright.sync_api import Page, expect

from biosensor_common.doctor.context import Context
from biosensor_common.doctor.two_sided.answering import Answerer
from biosensor_common.doctor.two_sided.facts import NODE
from biosensor_common.doctor.two_sided.remedies import ANSWER_PORT
from biosensor_gateway.doctor.guide import GUIDE
from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Server

OTHER = "127.0.0.2"
OpenWindow = Callable[..., Page]

expect.set_options(1000 * DEADLINE_S)


def test_both_computers_try_the_network_together(server: Server, window: OpenWindow) -> None:
    page = window(color_scheme="dark", viewport={"width": 400, "height": 800})
    page.goto(server.address)
    page.get_by_role("button", name="Check this computer").click()
    panel = page.get_by_role("region", name="Network to another computer")
    said: list[str] = []
    with (
        ThreadPoolExecutor(1) as pool,
        Answerer(Context(guide=GUIDE), NODE, ANSWER_PORT, address=OTHER) as answerer,
    ):
        answered = pool.submit(answerer.wait, said.append)
        panel.get_by_label("Address of that computer").fill(OTHER)
        wrong = f"{(int(answerer.code) + 1) % 1_000_000:06d}"
        for code, sentence in (
            (wrong, f"{OTHER} shows another code; type the one that stands there now"),
            (answerer.code, "a test stream is found when asked for directly, and received"),
        ):
            panel.get_by_label("Code").fill(code)
            panel.get_by_role("button", name="Try the network").click()
            expect(panel.locator("li", has_text=sentence).first).to_be_visible()
        answered.result(DEADLINE_S)
    assert len(said) == 1
    expect(panel.get_by_role("status")).to_have_text("Streams get through in both directions.")
    row = panel.locator("tr", has_text="TCP ")
    expect(row.locator("td")).to_have_text(["yes", "yes"])
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert violations(page) == []
    page.emulate_media(color_scheme="light")
    assert violations(page) == []


def test_what_is_no_computer_is_refused_in_one_sentence(server: Server) -> None:
    cookie = server.enter()
    for content in (
        {"host": "", "code": "123456"},
        {"host": "a b", "code": "123456"},
        {"host": OTHER, "code": "1" * 17},
        {"host": OTHER, "code": "123456", "port": 80},
        {"host": OTHER, "code": "123456", "command": "x"},
    ):
        answer = server.tell("POST", "network-check", cookie, content)
        assert answer.status == 422
        assert json.loads(answer.body)["problem"]
    answer = server.tell("POST", "network-check", cookie, {"host": OTHER, "code": "12"})
    assert answer.status == 200
    (finding,) = json.loads(answer.body)["findings"]
    assert "'12' is no code" in finding["what"]
