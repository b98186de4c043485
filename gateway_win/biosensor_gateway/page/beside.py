"""A server that runs beside the page's own, in the same process."""

from __future__ import annotations

import contextlib
from collections.abc import Generator

import uvicorn


class ServerBeside(uvicorn.Server):
    """Leaves the signals to the server that it runs beside."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        """Capture none."""
        yield
