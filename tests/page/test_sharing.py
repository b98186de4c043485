"""Looking on from another computer: everything is seen there, and nothing can be changed."""

from __future__ import annotations

import hashlib
import http.client
import re
import socket
import ssl
import subprocess
import sys
from collections.abc import Callable, Generator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

import biosensor_gateway.page
from biosensor_gateway.page.server import listening_at
from biosensor_gateway.page.share import CERTIFICATE_FILE, own_certificate
from tests.page.axe import violations
from tests.page.conftest import DEADLINE_S, Answer, Programs, Server

ADDRESS = re.compile(r"https://([\d.]+):(\d+)(/door\?token=\S+)")
expect.set_options(1000 * DEADLINE_S)
OpenWindow = Callable[..., Page]


class SharedServer(Server):
    """A page that other computers may look on; asked by this computer's own address."""

    def __init__(self, programs: Programs) -> None:
        super().__init__(programs, "--share", "--share-port", "0")
        self.host, port, self.door = self.said(ADDRESS).groups()
        self.view_port = int(port)

    @property
    def view(self) -> str:
        return f"https://{self.host}:{self.view_port}"

    def ask(self, path: str, cookie: str = "", method: str = "GET", **headers: str) -> Answer:
        """Ask over TLS, as another computer would."""
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        connection = http.client.HTTPSConnection(
            self.host, self.view_port, timeout=DEADLINE_S, context=context
        )
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        body = None if method == "GET" else b"{}"
        connection.request(method, path, body, {**named, **({"Cookie": cookie} if cookie else {})})
        got = connection.getresponse()
        answer = Answer(got.status, got.headers, got.read())
        connection.close()
        return answer

    def enter_view(self) -> str:
        """Take the way in; the cookie."""
        answer = self.ask(self.door)
        assert (answer.status, answer.headers["Location"]) == (303, "/")
        return answer.headers["Set-Cookie"].partition(";")[0]


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Generator[SharedServer]:
    programs = Programs(tmp_path_factory.mktemp("state"))
    yield SharedServer(programs)
    programs.end()


@pytest.mark.seam
def test_all_is_seen_and_nothing_can_be_pressed(shared: SharedServer, window: OpenWindow) -> None:
    host = window()
    host.goto(shared.address)
    host.get_by_text("Other computers can view this page").click()
    expect(host.locator("code", has_text=shared.view)).to_be_visible()
    assert violations(host) == []

    shared.programs.start("run", "--simulate", "zephyr")
    page = window(ignore_https_errors=True, viewport={"width": 400, "height": 800})
    page.goto(f"{shared.view}{shared.door}")
    assert page.url == f"{shared.view}/"
    expect(page.locator(".card", has_text="streaming")).to_have_count(1)
    expect(page.get_by_text("not recording")).to_be_visible()
    spark = page.locator("canvas").first
    before = spark.evaluate("canvas => canvas.toDataURL()")
    page.wait_for_function(
        "([canvas, before]) => canvas.toDataURL() !== before", arg=[spark.element_handle(), before]
    )
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert violations(page) == []
    # Also below the panel of the recording.
    bar = page.get_by_role("region", name="Current recording")
    expect(bar).to_have_count(0)
    page.set_viewport_size({"width": 400, "height": 300})
    page.get_by_role("button").scroll_into_view_if_needed()
    expect(bar.get_by_text("not recording")).to_be_in_viewport()
    assert page.locator("input").count() == 0
    pressed = page.get_by_role("button")
    expect(pressed).to_have_count(1)
    expect(pressed).to_contain_text("Traces and details")
    pressed.click()
    expect(page.get_by_role("heading", name="Streams")).to_be_visible()
    names = {each.inner_text().split()[0] for each in page.get_by_role("button").all()}
    assert names == {"Back", "copy"}
    # Where files lie says who uses the computer.
    assert str(shared.programs.folder) not in page.content()
    assert (
        str(shared.programs.folder).encode()
        not in shared.ask("/api/v1/status", shared.enter_view()).body
    )


@pytest.mark.nightly
def test_only_who_has_the_address_looks_on(shared: SharedServer) -> None:
    for path in ("/", "/page.css", "/api/v1/status"):
        assert shared.ask(path).status == 401
    assert shared.ask("/door?token=wrong").status == 403
    given = shared.ask(shared.door).headers["Set-Cookie"].lower()
    for word in ("httponly", "secure", "samesite=lax"):
        assert word in given
    # For several computers, and again after a restart of a browser.
    cookie = shared.enter_view()
    assert shared.ask("/", cookie).status == 200
    assert shared.ask("/", cookie, Host="evil.example").status == 421
    assert shared.ask("/", cookie, Origin="https://evil.example").status == 403
    # A link in a mail leads here; a script of another page does not.
    link = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate"}
    assert shared.ask(shared.door, **link).status == 303
    assert shared.ask("/api/v1/status", cookie, Sec_Fetch_Site="cross-site").status == 403


@pytest.mark.nightly
def test_the_two_ways_in_do_not_open_each_other(shared: SharedServer) -> None:
    cookie = shared.enter_view()
    value = cookie.partition("=")[2]
    own = f"biosensor_gateway_{shared.port}={value}"
    assert shared.request("GET", "/api/v1/status", own).status == 401
    assert shared.request("GET", shared.door, "").status == 403
    with (
        pytest.raises(ConnectionError),
        socket.create_connection((shared.host, shared.port), DEADLINE_S),
    ):
        pass


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "/api/v1/agent/stop"),
        ("POST", "/api/v1/agent/try"),
        ("POST", "/api/v1/devices"),
        ("DELETE", "/api/v1/devices"),
        ("POST", "/api/v1/recording/start"),
        ("POST", "/api/v1/markers"),
        ("PUT", "/api/v1/secrets"),
        ("GET", "/api/v1/secrets"),
        ("GET", "/api/v1/search"),
        ("GET", "/api/v1/openapi.json"),
    ],
)
def test_nothing_can_be_changed_and_no_more_be_read(
    shared: SharedServer, method: str, path: str
) -> None:
    answer = shared.ask(
        path,
        shared.enter_view(),
        method,
        Origin=shared.view,
        Content_Type="application/json",
    )
    assert answer.status in {404, 405}


@pytest.mark.nightly
def test_a_socket_of_another_page_is_refused(shared: SharedServer) -> None:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    headers = {"Cookie": shared.enter_view()}
    address = f"wss://{shared.host}:{shared.view_port}/live"
    with pytest.raises(InvalidStatus):
        connect(
            address, ssl=context, origin=Origin("https://evil.example"), additional_headers=headers
        )
    with connect(
        address, ssl=context, origin=Origin(shared.view), additional_headers=headers
    ) as socket_:
        assert '"agent"' in str(socket_.recv(DEADLINE_S))


@pytest.mark.nightly
def test_its_certificate_is_the_one_that_is_shown_and_stays(shared: SharedServer) -> None:
    pem = ssl.get_server_certificate((shared.host, shared.view_port))
    digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(pem)).hexdigest().upper()
    kept = own_certificate(shared.programs.folder, [shared.host])
    assert kept.fingerprint.replace(":", "") == digest
    if sys.platform != "win32":
        assert kept.file.stat().st_mode & 0o077 == 0
    # A browser accepts it for this address, once it is trusted.
    context = ssl.create_default_context(cadata=pem)
    with socket.create_connection((shared.host, shared.view_port)) as connection:
        context.wrap_socket(connection, server_hostname=shared.host).close()


def test_a_certificate_is_made_again_where_it_does_not_serve(tmp_path: Path) -> None:
    first = own_certificate(tmp_path, ["192.0.2.7", "lab-pc"])
    assert own_certificate(tmp_path, ["192.0.2.7"]) == first
    assert own_certificate(tmp_path, ["192.0.2.8"]) != first
    (tmp_path / CERTIFICATE_FILE).write_text("nonsense")
    assert own_certificate(tmp_path, ["192.0.2.7"]).fingerprint.count(":") == 31


@pytest.mark.nightly
def test_what_cannot_be_shared_is_said(programs: Programs) -> None:
    def refused(*arguments: str) -> str:
        command = [sys.executable, "-m", "biosensor_gateway.cli", "page", "--no-open", *arguments]
        done = subprocess.run(
            command, env=programs.environment, capture_output=True, check=False, timeout=DEADLINE_S
        )
        assert done.returncode == 1
        return " ".join(done.stderr.decode().split())

    with socket.create_server(("0.0.0.0", 0)) as taken:
        port = taken.getsockname()[1]
        said = refused("--share", "--share-port", str(port))
    assert f"TCP {port} cannot be opened" in said
    assert "--share-port" in said
    Server(programs)
    assert "page --end" in refused("--share")


# Connections to the page send what they have, and do not wait for the browser.
@pytest.mark.nightly
def test_an_accepted_connection_sends_at_once() -> None:
    with (
        listening_at("127.0.0.1", 0) as listening,
        socket.create_connection(listening.getsockname()),
    ):
        accepted, _ = listening.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_no_server_of_the_page_listens_by_other_means() -> None:
    sources = Path(biosensor_gateway.page.__file__).parent.rglob("*.py")
    found = [
        each.name for each in sources if re.search(r"create_server|\.bind\(", each.read_text())
    ]
    assert found == ["server.py"]
