"""The table of devices and their state that ``run`` and ``status --watch`` update in place."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple, Protocol

import typer
from rich.cells import cell_len, set_cell_size

from biosensor_common.errors import ConfigError
from biosensor_common.nonblocking_writer import console
from biosensor_common.terminal import shortened, wrapped
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.device_states import STATE_WORDS, is_sending, names
from biosensor_gateway.agent.rate_meter import RateMeter
from biosensor_gateway.cli.output import device_sentence, refused_now, restart_sentences
from biosensor_gateway.system.console_lines import (
    Line,
    Panel,
    Size,
    cursor_moves,
    shows_colours,
    terminal_size,
)

_WELL = frozenset({"streaming", "paused"})
_HEADINGS = ("Device", "State", "Rate", "Lost", "Battery")
_GAP = 2
_LEAST_NAME = 12
_MOST_LINES_OF_ERROR = 2
_MOST_REFUSED = 3
_AND_MORE = " ..."
_BOLD, _YELLOW = "\x1b[1m", "\x1b[33m"


class Row(NamedTuple):
    """The text of one device's row."""

    name: str
    state: str
    rate: str
    lost: str
    battery: str
    error: str
    refused: tuple[str, ...] = ()

    @property
    def cells(self) -> Sequence[str]:
        """The cells below the headings."""
        return self[: len(_HEADINGS)]  # pyright: ignore[reportReturnType]


class LiveTable:
    """Shows the agent's devices on a panel, and updates it with each report of the agent.

    Parameters
    ----------
    foot
        Returns the sentences below the table; by default, how long the agent has run and how to
        end it.
    """

    def __init__(
        self, panel: Panel, *, colours: bool, foot: Callable[[], Sequence[str]] | None = None
    ) -> None:
        self._panel, self._colours = panel, colours
        self._meters: dict[str, RateMeter] = {}
        self._begun_s = monotonic()
        self._foot = foot or self._running

    def report(self, status: Mapping[str, Any]) -> None:
        """Show a status of the agent; see `snapshot`."""
        rows = self.rows(status)
        foot = (*refused_now(status).values(), *self._foot())
        self._panel.show(partial(picture, rows, foot, colours=self._colours))

    def _running(self) -> Sequence[str]:
        return running_foot(int(monotonic() - self._begun_s))

    def rows(self, status: Mapping[str, Any]) -> list[Row]:
        """Return the rows of all devices."""
        now = float(status["lsl_time"])
        return [
            self._row(name, device, now)
            for name, device in zip(names(status["devices"]), status["devices"], strict=True)
        ]

    def _row(self, name: str, device: Mapping[str, Any], now: float) -> Row:
        state = "paused" if device["paused"] else STATE_WORDS[device["state"]]
        # While a device does not send, its rate and battery are outdated, and what it loses is
        # counted only when it is back.
        is_current = is_sending(device["state"], paused=device["paused"])
        rate = self._rate(device, now)
        battery = device["battery_percent"] if is_current else None
        lost = sum(each["lost"] for each in device["streams"].values())
        return Row(
            name,
            state,
            "-" if rate is None or not is_current else f"{rate:.1f} Hz",
            str(lost) if is_current else "-",
            "-" if battery is None else f"{battery:.0f} %",
            " ".join((device["error"] or "").split()),
            tuple(" ".join(each.split()) for each in refused_now(device).values()),
        )

    def _rate(self, device: Mapping[str, Any], now: float) -> float | None:
        """Return the rate of the fastest stream that is sending; None if none is."""
        sending = {
            source: each
            for source, each in device["streams"].items()
            if each["pushed"] and not each["silent"]
        }
        if not sending:
            return None
        main = max(sending, key=lambda source: sending[source]["nominal_hz"])
        each = sending[main]
        meter = self._meters.setdefault(main, RateMeter(each["nominal_hz"]))
        meter.note(each["pushed"], each["last_stamp"])
        return meter.rate_hz(now)


def picture(
    rows: Sequence[Row], sentences: Sequence[str], size: Size, *, colours: bool
) -> list[Line]:
    """Return the lines of the table and of the sentences below it, for a terminal of this size.

    The last line counts the devices that do not fit.
    """
    width = size.columns - 1
    foot = [line for each in sentences for line in wrapped(each, width).splitlines()]
    # An empty line above separates the table from the log.
    room = size.lines - 1 - len(foot) - 2
    if room < 1:
        return [Line(each) for each in foot[:1]]
    body = list(_body(rows, width, room))
    lines = [Line(""), *body, *(Line(each) for each in foot)]
    return lines if colours else [Line(each.text) for each in lines]


def _body(rows: Sequence[Row], width: int, room: int) -> Iterator[Line]:
    columns = _columns(rows, width)
    yield Line(_line(_HEADINGS, columns), _BOLD)
    drawn = [list(_device(row, columns, width)) for row in rows]
    if sum(map(len, drawn)) > room:
        drawn = [lines[:1] for lines in drawn]
    hidden = len(drawn) - room
    if hidden > 0:
        drawn = drawn[: room - 1]
    for lines in drawn:
        yield from lines
    if hidden > 0:
        yield Line(f"... and {hidden + 1} more")
    if not rows:
        yield Line("no device is enabled in the settings", _YELLOW)


def _device(row: Row, columns: Mapping[int, int], width: int) -> Iterator[Line]:
    is_well = row.state in _WELL and not row.error and not row.refused
    colour = "" if is_well else _YELLOW
    yield Line(_line(row.cells, columns), colour)
    shown = [each for each in (row.error, *row.refused[:_MOST_REFUSED]) if each]
    if (more := len(row.refused) - _MOST_REFUSED) > 0:
        shown.append(f"and {more} more like these")
    for sentence in shown:
        lines = wrapped(f"  {sentence}", width, 2).splitlines()
        if len(lines) > _MOST_LINES_OF_ERROR:
            last = lines[_MOST_LINES_OF_ERROR - 1][: width - len(_AND_MORE)]
            lines = [*lines[: _MOST_LINES_OF_ERROR - 1], last + _AND_MORE]
        yield from (Line(each, colour) for each in lines)


def _columns(rows: Sequence[Row], width: int) -> dict[int, int]:
    """Return the width of each column that fits; the rightmost columns are left out first."""
    sizes = [
        max(cell_len(cells[column]) for cells in (_HEADINGS, *(row.cells for row in rows)))
        for column in range(len(_HEADINGS))
    ]
    shown = len(sizes)
    while shown > 1 and width - _wide(sizes[1:shown]) < min(_LEAST_NAME, sizes[0]):
        shown -= 1
    name = max(1, min(sizes[0], width - _wide(sizes[1:shown])))
    return {0: name, **{column: sizes[column] for column in range(1, shown)}}


def _wide(sizes: Sequence[int]) -> int:
    return sum(sizes) + _GAP * len(sizes)


def _line(cells: Sequence[str], columns: Mapping[int, int]) -> str:
    parts: list[str] = []
    for column, size in columns.items():
        text = shortened(cells[column], size) if column == 0 else cells[column]
        # Names and states are aligned to the left, figures to the right.
        is_figure = column > 1
        blank = " " * (size - cell_len(text))
        parts.append(blank + text if is_figure else set_cell_size(text, size))
    return (" " * _GAP).join(parts).rstrip()


def running_foot(running_s: int) -> Sequence[str]:
    """Return the sentences below the table of an agent that has run for *running_s* seconds."""
    minutes, seconds = divmod(running_s, 60)
    hours, minutes = divmod(minutes, 60)
    return (
        f"Running for {hours}:{minutes:02}:{seconds:02}. Press Ctrl-C to end it.",
        "More, in another window: biosensor-gateway status",
    )


LOOK_S = 0.25
_LAST_LINES_S = 1.0
_NO_DEVICE = "the agent is running, but no device is enabled in its settings"
_END = "Press Ctrl-C to stop watching; the agent continues."


class _View(Protocol):
    """Shows the status of a running agent."""

    def status(self, status: Mapping[str, Any]) -> None:
        """Show the newest status."""
        ...

    def absence(self, sentence: str) -> None:
        """Show that no agent runs; called once each time that it goes away."""
        ...


def watch(folder: Path, *, as_json: bool) -> None:
    """Show the status of a state folder's agent until Ctrl-C, also after the agent was away."""
    # Ctrl-C is the usual end, not a failure.
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
            # Compared by state, not by sentence: the sentence may count seconds.
            if not is_away:
                view.absence(str(error))
            is_away = True
        else:
            if is_away or current["written"] != written:
                view.status(current)
            written, is_away = current["written"], False
        time.sleep(LOOK_S)


class _JsonLines:
    """Prints one JSON object per line: a status of the agent, or the problem."""

    def status(self, status: Mapping[str, Any]) -> None:
        typer.echo(json.dumps(status))

    def absence(self, sentence: str) -> None:
        typer.echo(json.dumps({"problem": sentence}))


class _Lines:
    """Prints a line with the local time for each change, where a table cannot be updated."""

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
    """Shows the table of ``run``, updated in place."""

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
    """Yield a panel of lines that can be updated; None if this terminal cannot have one."""
    if not sys.stdout.isatty():
        yield None
        return
    descriptor = sys.stdout.fileno()
    with cursor_moves(descriptor) as can_move:
        writer = console(descriptor, "terminal") if can_move else None
        if writer is None:
            yield None
            return
        panel = Panel(writer, partial(terminal_size, descriptor), sys.stdout.encoding)
        try:
            yield panel
        finally:
            writer.close(_LAST_LINES_S)
