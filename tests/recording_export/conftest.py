"""Recordings to export."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator
from pathlib import Path

import pytest

from biosensor_gateway.recording.contents.choice import BATCH, Selection
from biosensor_gateway.recording.export.exporter import Clock, Times
from biosensor_gateway.recording.export.job import Task, export
from biosensor_gateway.recording.export.outcome import Outcome

Exporting = Callable[..., Outcome]


@pytest.fixture(scope="package", autouse=True)
def _no_wait_for_the_disk() -> Generator[None]:  # pyright: ignore[reportUnusedFunction]
    """Hundreds of small files are exported, and none has to outlive the power."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "fsync", lambda _file: None)  # pyright: ignore[reportUnknownLambdaType, reportUnknownArgumentType]
        yield


@pytest.fixture
def exported(tmp_path: Path) -> Exporting:
    """Exports the bytes of a recording, which lies in a folder of its own."""

    def run(
        content: bytes,
        *formats: str,
        selection: Selection = Selection(),  # noqa: B008 - it cannot be changed
        clock: Clock = Clock.LSL,
        output: Path | None = None,
        times: Times = Times.RECORDED,
        batch: int = BATCH,
    ) -> Outcome:
        path = tmp_path / "study.xdf"
        path.write_bytes(content)
        task = Task(formats, selection, clock=clock, output=output, times=times, batch=batch)
        return export(path, task, lambda _name, _s: lambda _done: None)

    return run
