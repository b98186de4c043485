"""Recordings to export."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from biosensor_gateway.recording.contents.choice import Wish
from biosensor_gateway.recording.export.exporter import Clock
from biosensor_gateway.recording.export.exporting import Outcome, Task, export

Exporting = Callable[..., Outcome]


@pytest.fixture
def exported(tmp_path: Path) -> Exporting:
    """Exports the bytes of a recording, which lies in a folder of its own."""

    def run(
        content: bytes,
        *formats: str,
        wish: Wish = Wish(),  # noqa: B008 - it cannot be changed
        clock: Clock = Clock.LSL,
        output: Path | None = None,
    ) -> Outcome:
        path = tmp_path / "study.xdf"
        path.write_bytes(content)
        return export(
            path, Task(formats, wish, clock, output), lambda _name, _s: lambda _done: None
        )

    return run
