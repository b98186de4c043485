"""What helps before a study: this computer examined, a device tried, secrets handed over."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Callable, Generator
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from biosensor_common.doctor.network_check.sides import ANSWER_PORT
from biosensor_common.process_limits import ARENAS
from biosensor_gateway.devices.empatica_e4.simulator.e4 import SimulatedE4
from biosensor_gateway.simulation.world import World
from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Programs, Server
from tests.rigs import file_keyring
from tests.rigs.processes import count_arenas
from tests.rigs.wristbands import LOCATED

pytestmark = pytest.mark.nightly

HEADSET = '[[device]]\nsensor = "emotiv_insight"\nunit = "A"\n'
TEXT = "n0body-may-read-this"
expect.set_options(1000 * DEADLINE_S)
OpenWindow = Callable[..., Page]


@pytest.fixture
def wristband() -> Generator[SimulatedE4]:
    with World() as world, SimulatedE4(world, device_id="9ff167") as running:
        yield running


def test_this_computer_is_examined_and_the_command_finds_the_same(
    server: Server, window: OpenWindow
) -> None:
    server.programs.settings.write_text('[lsl]\nport_range = "many"\n')
    page = window(color_scheme="light", viewport={"width": 400, "height": 800})
    page.goto(server.address)
    with page.expect_response("**/api/v1/doctor") as answer:
        page.get_by_role("button", name="Check this computer").click()
    said = answer.value.json()
    panel = page.get_by_role("region", name="Check of this computer")
    wrong = panel.locator("li", has_text="port_range")
    expect(wrong.locator(".state")).to_have_text("▲ error")
    expect(wrong.locator("pre")).to_contain_text("config edit")
    levels = [
        each.split()[1]
        for each in panel.locator(".findings").first.locator(".state").all_inner_texts()
    ]
    assert levels == sorted(levels, key=["error", "warning", "note"].index)
    assert "how to fix it" in panel.get_by_role("status").inner_text()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert violations(page) == []
    panel.get_by_role("button", name="Close").click()
    expect(panel).to_have_count(0)

    command = [sys.executable, "-m", "biosensor_gateway.cli", "doctor", "--json"]
    # Its exit code tells of errors, which this computer may have.
    done = subprocess.run(
        command, env=server.programs.environment, capture_output=True, check=False
    )
    told = json.loads(done.stdout)
    assert {each["check"] for each in said["findings"]} >= {
        each["check"] for each in told["findings"] if each["level"] == "error"
    }
    assert said.keys() == told.keys()
    assert said["findings"][0].keys() == told["findings"][0].keys()


def test_a_device_that_was_found_is_tried(
    server: Server, window: OpenWindow, wristband: SimulatedE4
) -> None:
    server.programs.settings.write_text(LOCATED.format(**wristband.settings))
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Find sensors").first.click()
    entry = page.locator(".found li", has_text="9ff167")
    entry.get_by_role("button", name="Test").click()
    expect(entry.get_by_text("it works")).to_be_visible()
    assert violations(page) == []
    rate = entry.locator("li", has_text="gsr").inner_text().split()
    assert abs(float(rate[1]) - 4) < 0.5
    # Nothing is streamed, and nothing is in the settings.
    expect(page.get_by_text("agent does not run")).to_be_visible()
    assert "9FF167" not in server.programs.settings.read_text()

    entry.get_by_role("button", name="Add").click()
    expect(page.locator(".card", has_text="streaming")).to_have_count(1)
    (cookie,) = page.context.cookies()
    candidate = {"sensor": "empatica_e4", "settings": {"unit": "9FF167", **wristband.settings}}
    answer = server.tell(
        "POST", "devices/test", f"{cookie.get('name')}={cookie.get('value')}", candidate
    )
    assert answer.status == 409
    assert "the agent is using this device" in json.loads(answer.body)["problem"]


def test_a_secret_is_written_and_never_read(server: Server, window: OpenWindow) -> None:
    server.programs.settings.write_text(HEADSET)
    page = window()
    page.goto(server.address)
    page.get_by_role("button", name="Start streaming").click()
    page.get_by_role("button", name="Traces and details").click()
    form = page.locator("form", has=page.locator("input[type=password]")).first
    expect(form.get_by_text("missing")).to_be_visible()
    form.locator("input").fill(TEXT)
    assert violations(page) == []
    form.get_by_role("button", name="Keep").click()
    expect(form.get_by_text("known, from the keyring")).to_be_visible()
    assert TEXT in file_keyring.entries(server.programs.keyring).values()
    expect(form.locator("input")).to_have_value("")

    for path in ("secrets", "status"):
        assert TEXT not in page.evaluate(f"fetch('/api/v1/{path}').then(answer => answer.text())")
    assert TEXT not in page.content()
    for file in server.programs.folder.rglob("*"):
        if file.is_file() and file != server.programs.keyring:
            assert TEXT.encode() not in file.read_bytes(), file


def test_a_secret_that_cannot_be_kept_is_refused_without_its_text(server: Server) -> None:
    server.programs.settings.write_text(HEADSET)
    cookie = server.enter()
    for secret, code in (
        ({"sensor": "emotiv_insight", "name": "client_id", "text": " "}, 400),
        ({"sensor": "emotiv_insight", "name": "other", "text": TEXT}, 404),
        ({"sensor": "emotiv_insight", "name": "client_id", "text": [TEXT]}, 422),
        ({"sensor": "zephyr", "name": "client_id", "text": TEXT}, 404),
    ):
        answer = server.tell("PUT", "secrets", cookie, secret)
        assert answer.status == code
        assert TEXT.encode() not in answer.body
    assert file_keyring.entries(server.programs.keyring) == {}


# The network to another computer, tried from the page; both computers are this one.
OTHER = "127.0.0.2"
ANSWER = "network-check/answer"
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
    expect(
        answering.get_by_text("this computer answers any computer that knows the code")
    ).to_be_visible()
    code = answering.locator("dd .code").inner_text()
    expect(answering.get_by_text(f"--code {code}").first).to_be_visible()
    assert there.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert violations(there) == []

    panel.get_by_label("Address of that computer").fill(OTHER)
    wrong = f"{(int(code) + 1) % 1_000_000:06d}"
    for typed, sentence in (
        (wrong, f"{OTHER} shows another code; type the one shown there now"),
        (code, "a test stream is found when asked for directly, and received"),
    ):
        panel.get_by_label("Code").fill(typed)
        panel.get_by_role("button", name="Test the network").click()
        if typed == wrong:
            expect(answering.locator("p.reason")).to_have_count(1)
        else:
            expect(answering.get_by_role("status")).to_contain_text("Another computer is connected")
            expect(answering.get_by_role("button", name="Stop answering")).to_be_disabled()
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
    cancel = panel.get_by_role("button", name="Stop answering")
    expect(cancel).to_be_visible()
    # Another window, or a script.
    (cookie,) = page.context.cookies()
    sent = f"{cookie.get('name')}={cookie.get('value')}"
    second = server.tell("POST", ANSWER, sent, {})
    assert second.status == 409
    assert "this computer is already answering" in json.loads(second.body)["problem"]
    cancel.click()
    expect(panel.get_by_role("status")).to_contain_text("no longer answers")
    expect(panel.locator("dd .code")).to_have_count(0)

    with socket.create_server(("", ANSWER_PORT)):
        panel.get_by_role("button", name="Answer another computer").click()
        expect(panel.get_by_role("alert")).to_contain_text(
            f"TCP {ANSWER_PORT} is not available here"
        )
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
    assert "'12' is not a code" in finding["what"]


# The page's server keeps to few arenas of malloc, however many threads it has had.
@pytest.mark.skipif(sys.platform != "linux", reason="glibc's arenas")
def test_it_has_few_arenas(server: Server, window: Callable[..., Page]) -> None:
    page = window()
    page.goto(server.address)
    # Answered when everything is loaded, which happens in threads.
    assert page.evaluate("fetch('/api/v1/status').then(each => each.status)") == 200
    print(f"{count_arenas(server.process.pid)} arenas")
    assert count_arenas(server.process.pid) == ARENAS
