"""Reads what the agent's log file says last of one device."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel, Field

from biosensor_gateway.system.console_lines import on_one_line, sentence_of
from biosensor_gateway.system.logs import LOG_FILE_NAME

MOST_LINES = 20
MOST_BYTES = 256 * 1024
"""That is read of a file, from its end."""
_MOST_LETTERS = 400
# When a file is full, the next one begins empty.
_FILES = (LOG_FILE_NAME, f"{LOG_FILE_NAME}.1")


class LogLine(BaseModel):
    """One line of the log.

    Attributes
    ----------
    time
        ISO 8601 in UTC.
    level
        ``debug``, ``info``, ``warning``, ``error`` or ``critical``.
    sentence
        What happened, with its facts; at most 400 letters.
    """

    time: str
    level: str
    sentence: str


class LogView(BaseModel):
    """What the log says last of a device, the newest first; nothing if there is no log."""

    lines: list[LogLine] = Field(default_factory=list[LogLine])


def add_device_log(router: APIRouter, folder: Path) -> None:
    """Add what the page asks of the log in the state folder of the agent."""

    @router.get("/devices/log")
    async def device_log(sensor: str, unit: str) -> LogView:  # pyright: ignore[reportUnusedFunction]
        """Say what the log says last of a device."""
        return await asyncio.to_thread(last_lines, folder, sensor, unit)


def last_lines(folder: Path, sensor: str, unit: str) -> LogView:
    """Return the newest lines about a device, `MOST_LINES` at most.

    Of each file the last `MOST_BYTES` are read; what is no line of the log is passed over.

    Parameters
    ----------
    folder
        The state folder of the agent.
    sensor, unit
        Which device.
    """
    lines: list[LogLine] = []
    for name in _FILES:
        for record in _newest_first(folder / name):
            if len(lines) == MOST_LINES:
                return LogView(lines=lines)
            if (record.get("sensor"), record.get("unit")) == (sensor, unit):
                lines.append(_line(record))
    return LogView(lines=lines)


def _newest_first(path: Path) -> Iterator[dict[str, Any]]:
    for text in reversed(_end_of(path).splitlines()):
        try:
            record = json.loads(text)
        except (ValueError, RecursionError):
            # It begins within a line, and the last one may be half written.
            continue
        if isinstance(record, dict):
            yield record


def _end_of(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - MOST_BYTES))
            return file.read(MOST_BYTES)
    except OSError:
        return b""


def _line(record: dict[str, Any]) -> LogLine:
    sentence = on_one_line(sentence_of(record))
    return LogLine(
        time=str(record.get("timestamp", ""))[:40],
        level=str(record.get("level", ""))[:10],
        sentence=sentence if len(sentence) <= _MOST_LETTERS else f"{sentence[:_MOST_LETTERS]} …",
    )
