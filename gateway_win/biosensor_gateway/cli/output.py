"""Prints what fits the terminal, puts an agent's status into sentences, and asks a person."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from biosensor_common.refusal import Refusal
from biosensor_common.terminal import columns, shortened, wrapped
from biosensor_gateway.agent.state import STATE_WORDS

# Where there is no terminal, nothing needs to fit.
_ENDLESS = 10_000
_GAP = 2


def console() -> Console:
    """Return the terminal, or what stands in for it and never breaks a line."""
    return Console(width=None if sys.stdout.isatty() else _ENDLESS)


def say(text: str, hang: int = 2) -> None:
    """Print a sentence; on a terminal its lines end between words."""
    typer.echo(wrapped(text, columns(sys.stdout), hang))


def table_of_names(headings: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> Table:
    """Return a table of names and figures that is no wider than this.

    A name, in the first column, goes on in the next line; words of it that still do not
    fit lose their middle. Figures are shown whole.
    """
    sizes = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    left = max(len(headings[0]), width - sum(sizes[1:]) - _GAP * len(sizes))
    table = Table(box=None)
    table.add_column(headings[0], max_width=left)
    for heading, size in zip(headings[1:], sizes[1:], strict=True):
        table.add_column(heading, justify="right", no_wrap=True, min_width=size)
    for name, *figures in rows:
        words = " ".join(shortened(word, left) for word in name.split(" "))
        # Square brackets in a label are no markup.
        table.add_row(escape(words), *figures)
    return table


_Answer = TypeVar("_Answer")


class NotAnAnswerError(ValueError):
    """What was typed cannot be understood; the text says what is expected."""


def can_ask() -> bool:
    """Whether somebody at a terminal reads questions and can answer."""
    # A program without a console on Windows has none of them.
    streams = (sys.stdin, sys.stdout, sys.stderr)
    return all(each is not None and each.isatty() for each in streams)


def ask(question: str, understand: Callable[[str], _Answer]) -> _Answer:
    """Ask until it is understood.

    Parameters
    ----------
    understand
        Gets what was typed, without blanks at its ends; raises `NotAnAnswerError`.

    Raises
    ------
    typer.Exit
        With code 2 if nobody can answer any more: nobody could the next time, either.
    """
    while True:
        try:
            answer = input(f"{question} ")
        except EOFError:
            typer.echo()
            raise typer.Exit(2) from None
        try:
            return understand(answer.strip())
        except NotAnAnswerError as error:
            say(str(error))


def menu(question: str, choices: Sequence[str]) -> int:
    """Have one of several chosen, the first by Enter alone; return its index."""
    typer.echo()
    say(question)
    number(choices)
    return ask(
        "Type a number, then Enter [1]:", lambda text: _number(text or "1", len(choices)) - 1
    )


def several(choices: Sequence[str], prompt: str, if_empty: Sequence[int]) -> list[int]:
    """Have some of several chosen; return their indices, each once.

    Parameters
    ----------
    prompt
        Says what Enter alone means.
    if_empty
        What it means.
    """
    number(choices)

    def understand(text: str) -> list[int]:
        words = text.replace(",", " ").split()
        if not words:
            return list(if_empty)
        return list(dict.fromkeys(_number(word, len(choices)) - 1 for word in words))

    return ask(prompt, understand)


def number(choices: Sequence[str]) -> None:
    """List what can be chosen."""
    for index, choice in enumerate(choices, 1):
        say(f"  {index:>2}  {choice}", hang=6)


def _number(word: str, most: int) -> int:
    if word.isascii() and word.isdigit() and len(word) < 10 and 1 <= int(word) <= most:
        return int(word)
    # What was typed may be long, or hold what no terminal should be given back.
    shown = repr(word if len(word) <= 20 else f"{word[:20]}...")
    expected = "only 1 can be chosen" if most == 1 else f"type a number from 1 to {most}"
    raise NotAnAnswerError(f"{shown} is not in the list; {expected}")


def restart_sentences(status: Mapping[str, Any]) -> Iterator[str]:
    """Say that the agent had died, if it had."""
    if status.get("restarts"):
        times = "once" if status["restarts"] == 1 else f"{status['restarts']} times"
        yield f"started again {times}, last after: {status['last_end']}"


def refusal_sentences(status: Mapping[str, Any]) -> Iterator[str]:
    """Say what was not passed on as it came, of an agent, a device or a stream."""
    for each in status.get("refusals", ()):
        yield each["sentence"] + ("" if each["now"] else " (not lately)")


def refused_now(status: Mapping[str, Any]) -> dict[str, str]:
    """Return what is not passed on as it came now: of an agent alone, or of a device and streams.

    Returns
    -------
    dict of str
        Sentences by what they are about, whose counts may grow; a pause is said by the state.
    """
    return {
        f"{source} {told['what']} {told.get('about', '')}": (
            f"{source}: {told['sentence']}" if source else told["sentence"]
        )
        for source, part in (("", status), *status.get("streams", {}).items())
        for told in part.get("refusals", ())
        if told["now"] and told["what"] != Refusal.PAUSED.word
    }


def device_sentence(device: Mapping[str, Any]) -> str:
    """Say who wears a device, how it does, and what is wrong."""
    name = " ".join(
        part for part in (device["participant"], device["sensor"], device["label"]) if part
    )
    word = STATE_WORDS.get(device["state"], device["state"])
    state = f"paused ({word})" if device["paused"] else word
    line = f"{name} ({device['unit']}): {state}"
    return line + (f" - {device['error']}" if device["error"] else "")
