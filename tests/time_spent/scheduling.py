"""Distributes files to workers so that those that need a processor of their own take turns."""

from __future__ import annotations

from collections.abc import Collection

import pytest
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling


class TurnsOfTheHeavy(LoadFileScheduling):
    """A file's tests stay together, and heavy files are all one worker's.

    Parameters
    ----------
    heavy
        Files, relative to the root.
    """

    def __init__(self, config: pytest.Config, log: Producer, heavy: Collection[str]) -> None:
        super().__init__(config, log)
        self._heavy = heavy

    def _split_scope(self, nodeid: str) -> str:
        file = super()._split_scope(nodeid)
        return "heavy" if file in self._heavy else file
