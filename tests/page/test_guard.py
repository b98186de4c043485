"""Who is not let in: each way by which a foreign page or program could try."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import struct
import sys
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from tests.page.axe import violations
from tests.page.conftest import (
    DEADLINE_S,
    STARTED,
    Answer,
    Programs,
    Server,
    assert_listens_on_loopback_alone,
)
from tests.page.test_network_reading import other_streams
from tests.page.test_window import OpenWindow

pytestmark = pytest.mark.nightly

JSON = {"Content_Type": "application/json"}
FOREIGN = "http://evil.example"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Generator[Server]:
    """One for all: nobody here gets far enough to change anything."""
    programs = Programs(tmp_path_factory.mktemp("state"))
    yield Server(programs)
    programs.end()


@pytest.fixture(scope="module")
def door(server: Server) -> Answer:
    """What the way in answers, which is there once."""
    return server.request("GET", server.address.removeprefix(server.origin), "")


@pytest.fixture(scope="module")
def cookie(door: Answer) -> str:
    return door.headers["Set-Cookie"].partition(";")[0]


def own(server: Server) -> dict[str, str]:
    return {**JSON, "Origin": server.origin}


@pytest.mark.seam
def test_the_way_in_opens_once_and_gives_a_cookie_that_scripts_cannot_read(
    server: Server, door: Answer
) -> None:
    path = server.address.removeprefix(server.origin)
    assert (door.status, door.headers["Location"]) == (303, "/")
    given = door.headers["Set-Cookie"].lower()
    assert "httponly" in given
    assert "samesite=strict" in given
    assert server.request("GET", path, "").status == 403
    assert server.request("GET", "/door?token=wrong", "").status == 403
    assert server.request("GET", "/door", "").status == 403


@pytest.mark.parametrize("mode", ["navigate", "no-cors"])
def test_a_link_from_elsewhere_opens_the_door_alone_and_only_with_the_token(
    server: Server, cookie: str, mode: str
) -> None:
    # As from the file by which a browser opens the page; what another page embeds is no link.
    link = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": mode}
    found = STARTED.search(server.programs.call("page", "--no-open"))
    assert found is not None
    path = found[0].removeprefix(server.origin)
    assert server.request("GET", "/door?token=wrong", "", None, **link).status == 403
    assert server.request("GET", "/api/v1/status", cookie, None, **link).status == 403
    answer = server.request("GET", path, "", None, **link)
    # No redirect: with what it leads to, a browser would not send the strict cookie.
    assert answer.status == (200 if mode == "navigate" else 403)
    assert ("Set-Cookie" in answer.headers) == (mode == "navigate")


@pytest.mark.seam
@pytest.mark.parametrize("path", ["/", "/page.css", "/api/v1/status", "/api/v1/openapi.json"])
def test_nothing_is_shown_without_the_cookie(server: Server, cookie: str, path: str) -> None:
    assert server.request("GET", path, "").status == 401
    assert server.request("GET", path, cookie[:-1]).status == 401
    assert server.request("GET", path, "a=b; =; \x7f").status == 401
    assert server.request("GET", path, cookie).status == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "[::1]:{port}"]
)
def test_a_foreign_name_for_this_computer_is_refused(
    server: Server, cookie: str, host: str
) -> None:
    # DNS rebinding: a page's own name leads to this server, so it is that page's "own" origin.
    name = host.format(port=server.port)
    answer = server.request("GET", "/api/v1/status", cookie, Host=name, Origin=f"http://{name}")
    assert answer.status == 421
    assert server.request("GET", "/door?token=x", "", Host=name).status == 421


@pytest.mark.seam
@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": FOREIGN},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
        {},
    ],
    ids=str,
)
def test_what_another_page_sends_does_nothing(
    server: Server, cookie: str, headers: Mapping[str, str]
) -> None:
    # With the cookie, as a browser would send it if SameSite were not heeded.
    trying = {**JSON, **headers}
    answer = server.request("POST", "/api/v1/agent/try", cookie, b"{}", **trying)
    assert answer.status == 403
    assert not (server.programs.folder / "control.json").exists()


def test_a_form_of_another_page_is_no_json(server: Server, cookie: str) -> None:
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data"):
        answer = server.request(
            "POST", "/api/v1/search", cookie, b"{}", Content_Type=kind, Origin=server.origin
        )
        assert answer.status == 415
    assert server.request("POST", "/api/v1/search", cookie, b"{}", **own(server)).status == 200


def test_a_message_of_ten_megabytes_is_refused_unread(server: Server, cookie: str) -> None:
    body = b'{"sensor": "' + b"x" * 10_000_000 + b'"}'
    with socket.create_connection(("127.0.0.1", server.port)) as connection:
        head = (
            f"POST /api/v1/devices HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n"
            f"Origin: {server.origin}\r\nCookie: {cookie}\r\nContent-Type: application/json\r\n"
            f"Content-Length: {len(body)}\r\n\r\n"
        )
        connection.sendall(head.encode())
        assert connection.recv(64).startswith(b"HTTP/1.1 413")
    no_length = server.request(
        "POST", "/api/v1/devices", cookie, None, Transfer_Encoding="chunked", **own(server)
    )
    assert no_length.status == 411


@pytest.mark.parametrize("case", ["no cookie", "no origin", "foreign origin", "foreign host"])
def test_a_socket_of_a_stranger_is_refused(server: Server, cookie: str, case: str) -> None:
    headers = {} if case == "no cookie" else {"Cookie": cookie}
    origin = {"no origin": None, "foreign origin": FOREIGN}.get(case, server.origin)
    host = "evil.example" if case == "foreign host" else "127.0.0.1"
    with (
        socket.create_connection(("127.0.0.1", server.port)) as connection,
        pytest.raises(InvalidStatus) as caught,
    ):
        connect(
            f"ws://{host}:{server.port}/live",
            sock=connection,
            origin=None if origin is None else Origin(origin),
            additional_headers=headers,
        ).close()
    assert caught.value.response.status_code == 403


def test_a_socket_that_sends_nonsense_is_let_go_and_others_go_on(
    server: Server, cookie: str
) -> None:
    def opened() -> ClientConnection:
        return connect(
            f"ws://127.0.0.1:{server.port}/live",
            origin=Origin(server.origin),
            additional_headers={"Cookie": cookie},
        )

    view: dict[str, object] = {"generation": 1, "streams": [], "window_s": 10, "pixels": 100}
    with opened() as good:
        for nonsense in ("{", "[]", json.dumps(view | {"pixels": 10**9}), "x" * 100_000, b"\x00"):
            with opened() as bad, pytest.raises(ConnectionClosed):
                bad.send(nonsense)
                while True:
                    bad.recv(timeout=30)
        good.send(json.dumps(view))
        while not isinstance(received := good.recv(timeout=30), bytes):
            pass
        assert struct.unpack_from("<I", received) == (1,)


def test_two_hundred_connections_neither_stop_it_nor_fill_it(server: Server, cookie: str) -> None:
    idle = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(200)]
    try:
        with ThreadPoolExecutor(8) as threads:
            asked = [
                threads.submit(server.request, "GET", "/api/v1/status", cookie) for _ in range(16)
            ]
            answers = [each.result().status for each in asked]
        # Idle ones count, too: it says that it is busy, and does not hang.
        assert set(answers) <= {200, 503}
    finally:
        for connection in idle:
            connection.close()
    while server.request("GET", "/api/v1/status", cookie).status != 200:
        pass
    assert server.process.poll() is None


def test_every_answer_forbids_what_no_page_of_ours_needs(server: Server, cookie: str) -> None:
    for path in ("/", "/api/v1/status", "/nothing", "/js/app.js"):
        headers = server.request("GET", path, cookie).headers
        policy = headers["Content-Security-Policy"]
        assert "default-src 'self'" in policy
        assert "unsafe" not in policy
        assert "http" not in policy
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Referrer-Policy"] == "no-referrer"
        assert headers["X-Frame-Options"] == "DENY"
    assert (
        server.request("GET", "/js/app.js", cookie)
        .headers["Content-Type"]
        .startswith("text/javascript")
    )


@pytest.mark.parametrize("path", ["/../pyproject.toml", "/%2e%2e/guard.py", "/js/../../guard.py"])
def test_no_file_beside_the_page_is_given_away(server: Server, cookie: str, path: str) -> None:
    assert server.request("GET", path, cookie).status == 404


def test_it_listens_on_loopback_alone(server: Server) -> None:
    assert_listens_on_loopback_alone(server.process, server.port)


# What is not passed on as it came stands on the card, in the details and on the network's page.


AGENT = "run --no-ask --features --simulate ble_heart_rate --fault repeat:90s@2s"
SKIN = {"name": "Skin", "type": "GSR", "rate": 100.0, "source_id": "electrodes", "unit": ""}
REPEATED = re.compile(r"ibi: \d+ samples were not sent: intervals between beats add up to more")
expect.set_options(1000 * DEADLINE_S)


def test_it_stands_where_a_person_looks(window: Callable[..., Page], programs: Programs) -> None:
    # Not that of the module: it shows the agent of these programs.
    server = Server(programs)
    programs.start(*AGENT.split())
    with other_streams([SKIN]):
        page = window()
        page.goto(server.address)
        card = page.locator('.card[data-device^="ble_heart_rate"]')
        expect(card.locator(".refused")).to_contain_text(REPEATED)
        expect(card.locator(".card-head .state.warn")).to_contain_text(
            "some data was changed or dropped"
        )
        own = page.locator(".panel", has_text="Some data is not passed on unchanged")
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


# Live features on both pages: beside what they come from, and no stale value as one of now.
RATE = re.compile(r"^\d+(\.\d)? bpm$")
NOTHING = "\u2013"
# How far from its mark the largest value of the ECG around each beat is, in pixels; the beats that
# have a whole pulse of ECG on both sides.
OFFSETS = """([beats, ecg]) => {
  const { traces } = window.biosensorLive;
  const [marks, trace] = [traces.get(beats), traces.get(ecg)];
  if (!marks || !trace || marks.numbers.length < 5) return null;
  const around = marks.numbers.slice(1, -2).map((mark) => {
    const rows = trace.numbers.map((number, i) => [number, trace.high[i][0]]);
    const near = rows.filter(([number]) => Math.abs(number - mark) < 10);
    return near.length ? near.reduce((a, b) => (b[1] > a[1] ? b : a))[0] - mark : 99;
  });
  return around.length > 2 ? around : null;
}"""
# The colour of marks is that of text; traces have another one.
IS_MARKED = """canvas => {
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] > 200 && data[i] < 60 && data[i + 1] < 60 && data[i + 2] < 70) return true;
  }
  return false;
}"""


def value(page: Page, feature: str) -> Locator:
    return page.locator(f'[data-feature="{feature}"]')


def require_marks(page: Page, beats: str, ecg: str) -> None:
    """Each beat is marked where the ECG is highest, and the mark is drawn."""
    offsets = page.wait_for_function(OFFSETS, arg=[beats, ecg]).json_value()
    assert all(abs(each) <= 1 for each in offsets), offsets
    spark = page.locator(".card", has_text="Polar").locator(".sparks canvas").first
    page.wait_for_function(IS_MARKED, arg=spark.element_handle())


def told(page: Page, path: str) -> Any:
    return page.evaluate("path => fetch(path).then(answer => answer.json())", path)


@pytest.mark.skipif(sys.platform == "win32", reason="halts a program by a signal")
def test_features_are_shown_with_their_quality_marked_in_traces_and_never_stale(
    programs: Programs, window: OpenWindow
) -> None:
    server = Server(programs)
    server.programs.start("run", "--no-ask", "--simulate", "polar_h10")
    features = server.programs.start("features")
    network = Server(server.programs, "--lsl")
    of_agent, of_network = window(color_scheme="light"), window(color_scheme="light")
    of_agent.goto(server.address)
    of_network.goto(network.address)
    for page in (of_agent, of_network):
        expect(value(page, "hr_live")).to_have_text(RATE)
        expect(page.get_by_role("group", name="Live features")).to_contain_text("quality good")

    (device,) = told(of_agent, "/api/v1/status")["devices"]
    found = {each["data_name"]: each for each in device["features"]}
    streams = {each["data_name"]: each for each in device["streams"].values()}
    assert found["hr_live"]["topic"] == "/biosensors/polar_h10/hr_live"
    # The strap says a rate of its own.
    assert abs(found["hr_live"]["values"][0] - streams["hr"]["values"][0]) < 5
    # What the newest is each second, by the stream beside the rate.
    assert found["hr_state"]["topic"] == "/biosensors/polar_h10/hr_state"
    told_of = re.compile(r"^HR, mean of \d+ intervals$")
    expect(value(of_agent, "hr_live")).to_have_attribute("title", told_of)
    require_marks(of_agent, found["beats"]["source_id"], streams["ecg"]["source_id"])
    seen = told(of_network, "/api/v1/streams")["devices"]
    (device,) = (each for each in seen if each["title"] == "Polar H10")
    keys = {each["data_name"]: each["source_id"] for each in device["streams"]}
    require_marks(of_network, keys["beats"], keys["ecg"])
    assert violations(of_agent) == violations(of_network) == []

    of_agent.get_by_role("button", name="Traces and details").click()
    expect(of_agent.get_by_text("\u25bc beat, \u25bd artefact")).to_be_visible()
    expect(of_agent.locator("tr", has_text="polar_h10-virtual-beats")).to_contain_text(" s, no")
    assert violations(of_agent) == []

    # One that hangs keeps its streams open, and says nothing any more.
    os.kill(features.pid, signal.SIGSTOP)
    try:
        for page in (of_agent, of_network):
            expect(value(page, "hr_live")).to_have_text(NOTHING)
    finally:
        os.kill(features.pid, signal.SIGCONT)
    for page in (of_agent, of_network):
        expect(value(page, "hr_live")).to_have_text(RATE)
