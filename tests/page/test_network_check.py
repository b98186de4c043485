"""The network to another computer, tried from the page; both computers are this one."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Generator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from biosensor_common.doctor.network_check.sides import ANSWER_PORT
from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Programs, Server

pytestmark = pytest.mark.nightly

OTHER = "127.0.0.2"
ANSWER = "network-check/answer"
OpenWindow = Callable[..., Page]

expect.set_options(1000 * DEADLINE_S)


@pytest.fixture
def other(tmp_path: Path) -> Generator[Server]:
    """The page of the other computer."""
    folder = tmp_path / "other"
    folder.mkdir()
    programs = Programs(folder)
    yield Server(programs)
    programs.end()


def opened(server: Server, window: OpenWindow, scheme: str) -> tuple[Page, Locator]:
    """Open the check of the network."""
    page = window(color_scheme=scheme, viewport={"width": 400, "height": 800})
    page.goto(server.address)
    page.get_by_role("button", name="Check this computer").click()
    return page, page.get_by_role("region", name="Network to another computer")


def test_both_computers_try_the_network_together(
    server: Server, other: Server, window: OpenWindow
) -> None:
    page, panel = opened(server, window, "dark")
    there, answering = opened(other, window, "light")
    answering.get_by_role("button", name="Answer another computer").click()
    expect(answering.get_by_text("this computer answers whoever knows the code")).to_be_visible()
    code = answering.locator("dd .code").inner_text()
    expect(answering.get_by_text(f"--code {code}").first).to_be_visible()
    assert there.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert violations(there) == []

    panel.get_by_label("Address of that computer").fill(OTHER)
    wrong = f"{(int(code) + 1) % 1_000_000:06d}"
    for typed, sentence in (
        (wrong, f"{OTHER} shows another code; type the one that stands there now"),
        (code, "a test stream is found when asked for directly, and received"),
    ):
        panel.get_by_label("Code").fill(typed)
        panel.get_by_role("button", name="Try the network").click()
        if typed == wrong:
            expect(answering.locator("p.reason")).to_have_count(1)
        else:
            expect(answering.get_by_role("status")).to_contain_text("Another computer is there")
            expect(answering.get_by_role("button", name="Cancel the answer")).to_be_disabled()
        expect(panel.locator("li", has_text=sentence).first).to_be_visible()
    for each in (panel, answering):
        expect(each.get_by_role("status")).to_have_text("Streams get through in both directions.")
        expect(each.locator("tr", has_text="TCP ").locator("td")).to_have_text(["yes", "yes"])
    for shown in (page, there):
        assert shown.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert violations(shown) == []
    page.emulate_media(color_scheme="light")
    assert violations(page) == []


def test_an_answer_is_cancelled_and_given_once_at_a_time(
    server: Server, window: OpenWindow
) -> None:
    page, panel = opened(server, window, "light")
    panel.get_by_role("button", name="Answer another computer").click()
    cancel = panel.get_by_role("button", name="Cancel the answer")
    expect(cancel).to_be_visible()
    # Another window, or a script.
    (cookie,) = page.context.cookies()
    sent = f"{cookie.get('name')}={cookie.get('value')}"
    second = server.tell("POST", ANSWER, sent, {})
    assert second.status == 409
    assert "this computer answers already" in json.loads(second.body)["problem"]
    cancel.click()
    expect(panel.get_by_role("status")).to_contain_text("does not answer any more")
    expect(panel.locator("dd .code")).to_have_count(0)

    with socket.create_server(("", ANSWER_PORT)):
        panel.get_by_role("button", name="Answer another computer").click()
        expect(panel.get_by_role("alert")).to_contain_text(f"TCP {ANSWER_PORT} cannot be had here")
    # A page that is ended meanwhile does not wait for whoever may come.
    first = json.loads(server.tell("POST", ANSWER, sent, {}).body)
    assert (first["state"], first["port"]) == ("waiting", ANSWER_PORT)
    server.process.terminate()
    assert server.process.wait(DEADLINE_S) is not None


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
