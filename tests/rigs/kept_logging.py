"""Leaves logging as it was: what sets it up does so for the whole process."""

from __future__ import annotations

import logging
from collections.abc import Generator
from contextlib import contextmanager

import structlog


@contextmanager
def kept_logging() -> Generator[None]:
    """Take back at the end what the block has set up; handlers that it has added are closed."""
    root, own = logging.getLogger(), logging.getLogger("biosensor_gateway")
    handlers, levels = root.handlers[:], (root.level, own.level)
    try:
        yield
    finally:
        for handler in root.handlers[:]:
            if handler not in handlers:
                root.removeHandler(handler)
                handler.close()
        root.setLevel(levels[0])
        own.setLevel(levels[1])
        structlog.reset_defaults()
        structlog.contextvars.clear_contextvars()
