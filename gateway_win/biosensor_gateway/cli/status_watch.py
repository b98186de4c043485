"""``biosensor-gateway status --watch``: how the agent does, until Ctrl-C."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Generator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import typer

from biosensor_common.errors import ConfigError
from biosensor_common.relay import console
from biosensor_common.terminal import wrapped
from biosensor_gateway.agent import status_file
from biosensor_gateway.cli.live_table import LiveTable
from biosensor_gateway.cli.status_words import (
    device_sentence,
    refused_now,
    restart_sentences,
)
from biosensor_gateway.system.panel import Line, Panel, Size
from biosensor_gateway.system.terminal import cursor_moves, shows_colours, terminal_size

LOOK_S = 0.25
_LAST_LINES_S = 1.0
_NO_DEVICE = "the agent runs, and no device is enabled in its settings"
_END = "Press Ctrl-C to end the watch; the agent goes on."


class _View(Protocol):
    """Shows an agent that is watched."""

    def status(self, status: Mapping[str, Any]) -> None:
        """Show what the agent has just said."""
        ...

    def absence(self, sentence: str) -> None:
        """Show that there is no agent; called once for each time that it goes away."""
        ...


def watch(folder: Path, *, as_json: bool) -> None:
    """Show how the agent of a state folder does, also after it was away, until Ctrl-C."""
    # Ctrl-C is how watching ends; it is no failure.
    with contextlib.suppress(KeyboardInterrupt):
        if as_json:
            _follow(folder, _JsonLines())
            return
        with _panel() as panel:
            _follow(folder, _Lines() if panel is None else _Table(panel))


def _follow(folder: Path, view: _View) -> None:
    written, is_away = None, False
    while True:
        try:
            current = status_file.running_status(folder)
        except ConfigError as error:
            # Its sentence may count seconds, which is nothing new.
            if not is_away:
                view.absence(str(error))
            is_away = True
        else:
            if is_away or current["written"] != written:
                view.status(current)
            written, is_away = current["written"], False
        time.sleep(LOOK_S)


class _JsonLines:
    """One object a line: each report of the agent, or the problem."""

    def status(self, status: Mapping[str, Any]) -> None:
        typer.echo(json.dumps(status))

    def absence(self, sentence: str) -> None:
        typer.echo(json.dumps({"problem": sentence}))


class _Lines:
    """A line with the local time for each change, for where no table can be renewed."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def status(self, status: Mapping[str, Any]) -> None:
        devices = [device_sentence(each) for each in status["devices"]] or [_NO_DEVICE]
        sentences = {each: each for each in (*restart_sentences(status), *devices)}
        for part in (status, *status["devices"]):
            sentences |= refused_now(part)
        self._say(sentences)

    def absence(self, sentence: str) -> None:
        self._say({sentence: sentence})

    def _say(self, sentences: dict[str, str]) -> None:
        for about, each in sentences.items():
            if about not in self._said:
                typer.echo(f"{time.strftime('%H:%M:%S')} {each}")
        self._said = set(sentences)


class _Table:
    """The table of ``run``, renewed in place."""

    def __init__(self, panel: Panel) -> None:
        self._panel = panel
        self._restarts: list[str] = []
        self._table = LiveTable(panel, colours=shows_colours(), foot=self._foot)

    def status(self, status: Mapping[str, Any]) -> None:
        self._restarts = [f"The agent was {each}" for each in restart_sentences(status)]
        self._table.report(status)

    def absence(self, sentence: str) -> None:
        self._panel.show(partial(_sentences, [sentence, *self._foot()]))

    def _foot(self) -> list[str]:
        return [*self._restarts, f"Seen at {time.strftime('%H:%M:%S')}. {_END}"]


def _sentences(sentences: list[str], size: Size) -> list[Line]:
    said = (line for each in sentences for line in wrapped(each, size.columns - 1).splitlines())
    return [Line(each) for each in said]


@contextlib.contextmanager
def _panel() -> Generator[Panel | None]:
    """Give the lines of this terminal that can be renewed; None where there are none."""
    if not sys.stdout.isatty():
        yield None
        return
    descriptor = sys.stdout.fileno()
    with cursor_moves(descriptor) as can_move:
        outflow = console(descriptor, "terminal") if can_move else None
        if outflow is None:
            yield None
            return
        panel = Panel(outflow, partial(terminal_size, descriptor), sys.stdout.encoding)
        try:
            yield panel
        finally:
            outflow.close(_LAST_LINES_S)
