"""Outlets of this process that are still open."""

from __future__ import annotations

import weakref
from collections.abc import Generator
from contextlib import contextmanager

import pylsl
import pytest


class OpenOutlets:
    """Those that were made while it watched."""

    def __init__(self) -> None:
        self._made: list[tuple[weakref.ref[pylsl.StreamOutlet], str]] = []

    def add(self, outlet: pylsl.StreamOutlet, info: pylsl.StreamInfo) -> None:
        """Note one that was made."""
        self._made.append((weakref.ref(outlet), info.source_id() or info.name()))

    @property
    def names(self) -> list[str]:
        """What is still open, by source_id."""
        return [name for outlet, name in self._made if outlet() is not None]


@contextmanager
def watch_outlets() -> Generator[OpenOutlets]:
    """Note the outlets that are made meanwhile."""
    watched = OpenOutlets()
    make = pylsl.StreamOutlet.__init__

    def noting(
        self: pylsl.StreamOutlet, info: pylsl.StreamInfo, *arguments: int, **named: int
    ) -> None:
        make(self, info, *arguments, **named)
        watched.add(self, info)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pylsl.StreamOutlet, "__init__", noting)
        yield watched
