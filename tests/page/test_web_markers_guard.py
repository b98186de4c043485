"""Who may mark from the web and who may not, and what each is told."""

from __future__ import annotations

import json
import re
import socket
import time
from collections.abc import Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.page.auth import MAX_EXPERIMENT_SOCKETS
from biosensor_gateway.page.experiments.experiment_server import SOCKET
from tests.page.conftest import DEADLINE_S, assert_listens_on_loopback_alone
from tests.page.web_lab import Answer, MarkerReader, WebLab
from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly

FOREIGN = "http://evil.example"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Generator[WebLab]:
    running = WebLab(tmp_path_factory.mktemp("state"))
    yield running
    running.close()


@pytest.fixture(scope="module")
def reader(lab: WebLab) -> MarkerReader:
    return MarkerReader()


def opened(lab: WebLab, origin: str | None = "") -> ClientConnection:
    named = lab.origin if origin == "" else origin
    return connect(
        f"{lab.address}{SOCKET}", origin=None if named is None else Origin(named), compression=None
    )


def told(socket: ClientConnection, kind: str) -> dict[str, Any]:
    """Answer pings until a message of this kind comes."""
    while True:
        message = json.loads(socket.recv(timeout=DEADLINE_S))
        if message["type"] == "ping":
            pong = {"type": "pong", "n": message["n"], "at": 1000 * time.monotonic()}
            socket.send(json.dumps(pong))
        if message["type"] == kind:
            return message


def greet(lab: WebLab, socket: ClientConnection) -> None:
    socket.send(json.dumps({"type": "hello", "token": lab.token}))


def closing(socket: ClientConnection) -> tuple[int, str]:
    with pytest.raises(ConnectionClosed) as caught:
        while True:
            socket.recv(timeout=DEADLINE_S)
    assert caught.value.rcvd is not None
    return caught.value.rcvd.code, caught.value.rcvd.reason


def test_a_marker_is_posted_by_a_page_of_a_named_origin(lab: WebLab, reader: MarkerReader) -> None:
    answer = lab.request("POST", {"marker": "posted", "note": "trial 3"})
    assert answer.code == 200
    assert answer.headers["Access-Control-Allow-Origin"] == lab.origin
    assert answer.headers["Vary"] == "Origin"
    assert answer.headers["Access-Control-Allow-Credentials"] is None
    assert answer.headers["Set-Cookie"] is None
    sent = reader.find("posted")
    stamp = sent.pop("stamp")
    assert stamp == pytest.approx(sent["lsl_time"], abs=1e-5)
    assert answer.said == {
        "id": sent["id"],
        "lsl_time": sent["lsl_time"],
        "timed_by": "arrival",
        "uncertainty_s": None,
    }
    assert sent == {
        "marker": "posted",
        "kind": "web",
        "id": sent["id"],
        "note": "trial 3",
        "source": lab.origin,
        "timed_by": "arrival",
        "lsl_time": sent["lsl_time"],
    }


def test_a_browser_is_told_before_it_sends(lab: WebLab) -> None:
    asked = {"Authorization": "", "Content_Type": "", "Access_Control_Request_Method": "POST"}
    answer = lab.request("OPTIONS", **asked, Access_Control_Request_Private_Network="true")
    assert answer.code == 204
    allowed = {
        name: value
        for name, value in answer.headers.items()
        if name.lower().startswith("access-control")
    }
    assert allowed == {
        "access-control-allow-origin": lab.origin,
        "access-control-allow-methods": "POST",
        "access-control-allow-headers": "Authorization, Content-Type",
        "access-control-max-age": "600",
        "access-control-allow-private-network": "true",
    }
    assert lab.request("OPTIONS", **asked).headers["Access-Control-Allow-Private-Network"] is None
    foreign = lab.request("OPTIONS", **asked, Origin=FOREIGN)
    assert foreign.code == 403
    assert "access-control-allow-origin" not in foreign.headers


WRONG = [
    (403, {"Origin": FOREIGN}),
    (403, {"Origin": ""}),
    (403, {"Origin": "http://127.0.0.1:1"}),
    (421, {"Host": "evil.example"}),
    (421, {"Host": "evil.example:{port}"}),
    (401, {"Authorization": ""}),
    (401, {"Authorization": "Bearer wrong"}),
    (401, {"Authorization": "Bearer "}),
    (401, {"Authorization": "Basic {token}"}),
    (401, {"Authorization": "{token}"}),
    (415, {"Content_Type": "text/plain"}),
    (415, {"Content_Type": ""}),
]


@pytest.mark.parametrize(("code", "headers"), WRONG, ids=str)
def test_whoever_may_not_marks_nothing(
    lab: WebLab, reader: MarkerReader, code: int, headers: Mapping[str, str]
) -> None:
    named = {k: v.format(port=lab.port, token=lab.token) for k, v in headers.items()}
    answer = lab.request("POST", {"marker": "smuggled"}, **named)
    assert answer.code == code
    assert str(answer.said).strip().endswith(".")
    # A page that may mark can read what is wrong; any other cannot.
    readable = "access-control-allow-origin" in answer.headers
    assert readable == (code not in {403, 421})
    assert lab.request("POST", {"marker": f"after {code}"}).code == 200
    reader.find(f"after {code}")
    assert reader.named("smuggled") == []


WRONG_CONTENT: list[tuple[object, str]] = [
    ({}, "marker: Field required"),
    ({"marker": ""}, "the marker has no text"),
    ({"marker": "two\nlines"}, "one line of printable text"),
    ({"marker": "x" * 201}, "at most 200 characters"),
    ({"marker": 3}, "valid string"),
    ({"marker": "x", "age_ms": -1}, "age_ms"),
    ({"marker": "x", "age_ms": 3_600_001}, "age_ms"),
    ({"marker": "x", "age_ms": "NaN"}, "age_ms"),
    ({"marker": "x", "at": 1.0}, "Extra inputs"),
    (b"{", "JSON"),
    (b"[]", "valid dictionary"),
]


@pytest.mark.parametrize(("body", "sentence"), WRONG_CONTENT, ids=str)
def test_what_is_no_marker_is_refused_with_a_sentence(
    lab: WebLab, body: object, sentence: str
) -> None:
    answer = lab.request("POST", body)
    assert answer.code in {400, 422}
    assert sentence in answer.said["problem"]


def test_what_is_too_long_is_refused_unread(lab: WebLab) -> None:
    assert lab.request("POST", {"marker": "x" * 5000}).code == 413
    assert lab.request("POST", Transfer_Encoding="chunked").code == 411


def test_the_token_opens_nothing_but_markers(lab: WebLab) -> None:
    for path in ("/", "/api/v1/status", "/api/v1/openapi.json", "/api/v1/markers/undo", "/live"):
        assert lab.request("GET", path=path).code == 404
        assert lab.request("POST", {}, path=path).code == 404
    assert lab.request("GET").code == 405
    # Neither at the other door: not with the token, and not the other way round.
    bearer = {"Authorization": f"Bearer {lab.token}", "Content_Type": "application/json"}
    assert lab.server.request("GET", "/api/v1/status", "", None, **bearer).status == 401
    for origin in (lab.origin, lab.server.origin):
        answer = lab.server.request(
            "POST", "/api/v1/markers", "", b'{"marker": "x"}', Origin=origin, **bearer
        )
        assert answer.status in {401, 403}
    answer = lab.request("POST", {"marker": "x"}, Authorization="", Cookie=lab.cookie)
    assert answer.code == 401


def test_it_listens_on_loopback_alone(lab: WebLab) -> None:
    assert_listens_on_loopback_alone(lab.server.process, lab.port)


@pytest.mark.parametrize("origin", [None, FOREIGN, "http://127.0.0.1:1"])
def test_a_socket_of_a_stranger_is_refused(lab: WebLab, origin: str | None) -> None:
    with pytest.raises(InvalidStatus) as caught:
        opened(lab, origin).close()
    assert caught.value.response.status_code == 403


HELLOS = [
    ('{"type": "hello", "token": "wrong"}', "the token is wrong; biosensor-gateway mark --web"),
    ('{"type": "mark", "ref": 1, "marker": "x"}', "the first message must be hello"),
    ("{", "the first message must be hello"),
    (b"\x00", "the first message must be hello"),
]


@pytest.mark.parametrize(("first", "reason"), HELLOS, ids=str)
def test_a_socket_without_the_token_is_closed(
    lab: WebLab, reader: MarkerReader, first: str | bytes, reason: str
) -> None:
    with opened(lab) as stranger:
        stranger.send(first)
        code, said = closing(stranger)
    assert (code, said[: len(reason)]) == (1008, reason)


NONSENSE = ["{", "[]", '{"type": "stop"}', b"\x00", '{"type": "mark", "ref": -1, "marker": "x"}']


@pytest.mark.parametrize("nonsense", NONSENSE, ids=str)
def test_a_socket_that_sends_nonsense_is_let_go_and_others_go_on(
    lab: WebLab, nonsense: str | bytes
) -> None:
    with opened(lab) as good, opened(lab) as bad:
        greet(lab, good)
        greet(lab, bad)
        bad.send(nonsense)
        assert closing(bad)[0] == 1008
        good.send(json.dumps({"type": "mark", "ref": 1, "marker": "goes on"}))
        assert told(good, "marked")["timed_by"] == "arrival"


def test_a_message_that_is_too_long_ends_its_socket(lab: WebLab) -> None:
    with opened(lab) as bad:
        greet(lab, bad)
        bad.send("x" * 5000)
        assert closing(bad)[0] == 1009


def test_a_marker_sent_again_is_marked_once(lab: WebLab, reader: MarkerReader) -> None:
    hello = {"type": "hello", "token": lab.token, "client": "page-1"}
    mark = {"type": "mark", "ref": 7, "marker": "sent twice"}
    answers: list[dict[str, Any]] = []
    for _ in range(2):
        with opened(lab) as page:
            page.send(json.dumps(hello))
            page.send(json.dumps(mark))
            answers.append(told(page, "marked"))
    assert answers[0] == answers[1]
    lab.request("POST", {"marker": "behind both"})
    reader.find("behind both")
    assert len(reader.named("sent twice")) == 1


@pytest.mark.parametrize(
    ("ahead_s", "sentence"),
    [(60, "s after its arrival, and the limit is 0.1 s"), (-4000, "and the limit is 3600 s")],
)
def test_a_time_that_cannot_be_is_refused(lab: WebLab, ahead_s: float, sentence: str) -> None:
    with opened(lab) as page:
        greet(lab, page)
        told(page, "ready")
        said: dict[str, Any] = {"again": True}
        while said["again"]:
            at_ms = 1000 * (time.monotonic() + ahead_s)
            page.send(json.dumps({"type": "mark", "ref": 1, "marker": "x", "at": at_ms}))
            said = told(page, "refused")
            # Until it is known how far the clocks are apart; in a hurry, it would be a flood.
            time.sleep(0.02)
        assert sentence in said["problem"]


def test_a_flood_of_messages_ends_its_socket_and_the_page_goes_on(lab: WebLab) -> None:
    with opened(lab) as bad:
        greet(lab, bad)
        with pytest.raises(ConnectionClosed) as caught:
            while True:
                bad.send(json.dumps({"type": "pong", "n": 1, "at": 0.0}))
    assert caught.value.rcvd is None or caught.value.rcvd.code == 1008
    with ExitStack() as stack:
        for _ in range(MAX_EXPERIMENT_SOCKETS):
            greet(lab, stack.enter_context(opened(lab)))
        with pytest.raises(InvalidStatus):
            opened(lab).close()
        assert lab.server.request("GET", "/api/v1/status", lab.cookie).status == 200
    wait_until(lambda: lab.request("POST", {"marker": "after the flood"}).code == 200)


def test_settings_hold_at_once(lab: WebLab) -> None:
    with opened(lab) as page:
        greet(lab, page)
        lab.allow(FOREIGN)
        # Whoever was let in by the settings before is let in again, or not.
        assert closing(page)[0] == 1012
    wait_until(lambda: lab.listens() and lab.request("POST", {"marker": "x"}).code == 403)
    lab.allow()
    wait_until(lambda: not lab.listens())
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port, lab.port = lab.port, taken.getsockname()[1]
        lab.allow(lab.origin)
        wait_until(lambda: f"port {lab.port} cannot be used" in _view(lab)["problem"])
    lab.port = port
    lab.allow(lab.origin)
    wait_until(lab.listens)
    lab.programs.call("mark", "--web", "--new-token")
    wait_until(lambda: lab.listens() and lab.request("POST", {"marker": "x"}).code == 200)


def _view(lab: WebLab) -> dict[str, Any]:
    """What the page is told of web experiments."""
    with connect(
        f"ws://127.0.0.1:{lab.server.port}/live",
        origin=Origin(lab.server.origin),
        additional_headers={"Cookie": lab.cookie},
    ) as live:
        while isinstance(received := live.recv(timeout=DEADLINE_S), bytes):
            pass
    return json.loads(received)["experiments"] or {"problem": ""}


@pytest.fixture
def without_agent(lab: WebLab) -> None:
    """End the agent, if a test before has not."""
    if is_held(lab.programs.folder):
        lab.programs.call("stop")


@pytest.mark.usefixtures("without_agent")
def test_without_an_agent_it_says_so(lab: WebLab) -> None:
    answer = lab.request("POST", {"marker": "x"})
    assert answer.code == 503
    assert re.search("no agent is running|does not answer", answer.said["problem"])
    with opened(lab) as page:
        greet(lab, page)
        page.send(json.dumps({"type": "mark", "ref": 1, "marker": "x"}))
        assert told(page, "refused")["again"]


@pytest.mark.usefixtures("without_agent")
def test_a_flood_of_markers_is_refused(lab: WebLab) -> None:
    # Without an agent, for one takes its time, so that a slow machine makes no flood of it.
    def post(_number: int) -> Answer:
        return lab.request("POST", {"marker": "flood"})

    answers: list[Answer] = []
    with ThreadPoolExecutor(8) as threads:
        wait_until(
            lambda: (
                answers.extend(threads.map(post, range(50)))
                or any(each.code == 429 for each in answers)
            )
        )
    assert {each.code for each in answers} == {503, 429}
    refused = next(each for each in answers if each.code == 429)
    assert refused.headers["Retry-After"] == "1"
    assert refused.said["problem"] == "more than 50 markers a second; send fewer, or later"
    assert refused.headers["Access-Control-Allow-Origin"] == lab.origin
    wait_until(lambda: post(0).code == 503)
