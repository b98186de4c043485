"""The page's server keeps to few arenas of malloc, however many threads it has had."""

from __future__ import annotations

import sys
from collections.abc import Callable

import pytest
from playwright.sync_api import Page

from biosensor_common.process_limits import ARENAS
from tests.page.conftest import Server
from tests.rigs.arenas import count_arenas

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="glibc's arenas"),
]


def test_it_has_few_arenas(server: Server, window: Callable[..., Page]) -> None:
    page = window()
    page.goto(server.address)
    # Answered when everything is loaded, which happens in threads.
    assert page.evaluate("fetch('/api/v1/status').then(each => each.status)") == 200
    print(f"{count_arenas(server.process.pid)} arenas")
    assert count_arenas(server.process.pid) == ARENAS
