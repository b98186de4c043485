"""Connections to the page send what they have, and do not wait for the browser."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import pytest

import biosensor_gateway.page
from biosensor_gateway.page.server import listening_at


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
