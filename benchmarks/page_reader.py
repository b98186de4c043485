"""Reads a page's live data in its place, and draws nothing."""

from __future__ import annotations

import json
import threading
from collections.abc import Generator
from contextlib import contextmanager

from playwright.sync_api import Page
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin


@contextmanager
def read_in_place_of(page: Page) -> Generator[None]:
    """Close a page, and go on with its view and its permission in the block."""
    origin: str = page.evaluate("location.origin")
    given = page.context.cookies()
    cookies = "; ".join(f"{each.get('name')}={each.get('value')}" for each in given)
    view = page.evaluate("({generation: 1, ...window.biosensorLive.view})")
    page.close()
    with connect(
        f"{origin.replace('http', 'ws')}/live",
        origin=Origin(origin),
        additional_headers={"Cookie": cookies},
    ) as connection:
        connection.send(json.dumps(view))
        reader = threading.Thread(target=_read, args=[connection], daemon=True)
        reader.start()
        yield
    reader.join()


def _read(connection: ClientConnection) -> None:
    try:
        while True:
            connection.recv()
    except ConnectionClosed:
        return
