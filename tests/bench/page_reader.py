"""Reads a page's live data in its place, and draws nothing."""

from __future__ import annotations

import json
import threading
from types import TracebackType
from typing import Self

from playwright.sync_api import Page
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Origin


class PageReader:
    """Takes over from a page, which it closes; a context manager.

    Parameters
    ----------
    page
        Whose view and permission it continues with.
    """

    def __init__(self, page: Page) -> None:
        origin: str = page.evaluate("location.origin")
        cookies = "; ".join(
            f"{each.get('name')}={each.get('value')}" for each in page.context.cookies()
        )
        view = page.evaluate("({generation: 1, ...window.biosensorLive.view})")
        page.close()
        self._connection = connect(
            f"{origin.replace('http', 'ws')}/live",
            origin=Origin(origin),
            additional_headers={"Cookie": cookies},
        )
        self._connection.send(json.dumps(view))
        self._thread = threading.Thread(target=self._read, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._connection.close()
        self._thread.join()

    def _read(self) -> None:
        try:
            while True:
                self._connection.recv()
        except ConnectionClosed:
            return
