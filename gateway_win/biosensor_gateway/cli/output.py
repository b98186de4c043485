"""Prints text and tables for the terminal, words an agent's status, and asks a person."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.refusal import Refusal
from biosensor_common.terminal import columns, shortened, wrapped
from biosensor_gateway.agent.device_states import STATE_WORDS

# A file or a pipe has no width, so no line is broken there.
_ENDLESS = 10_000
_GAP = 2


def console() -> Console:
    """Return a console for standard output that breaks lines only on a terminal."""
    return Console(width=None if sys.stdout.isatty() else _ENDLESS)


def say(text: str, hang: int = 2) -> None:
    """Print a sentence; on a terminal its lines end between words."""
    typer.echo(wrapped(text, columns(sys.stdout), hang))


def table_of_names(headings: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> Table:
    """Return a table of names and figures that fits into *width* characters.

    Long names, in the first column, are wrapped; words that still do not fit are shortened in
    the middle. Figures are shown whole.
    """
    sizes = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    left = max(len(headings[0]), width - sum(sizes[1:]) - _GAP * len(sizes))
    table = Table(box=None)
    table.add_column(headings[0], max_width=left)
    for heading, size in zip(headings[1:], sizes[1:], strict=True):
        table.add_column(heading, justify="right", no_wrap=True, min_width=size)
    for name, *figures in rows:
        words = " ".join(shortened(word, left) for word in name.split(" "))
        # Without this, rich would take square brackets in a label for markup.
        table.add_row(escape(words), *figures)
    return table


_Answer = TypeVar("_Answer")


class NotAnAnswerError(ValueError):
    """The answer cannot be understood; the message says what is expected."""


def can_ask() -> bool:
    """Whether input and output are a terminal, at which a person can answer."""
    # A windowed program on Windows has none of these streams.
    streams = (sys.stdin, sys.stdout, sys.stderr)
    return all(each is not None and each.isatty() for each in streams)


def ask(question: str, understand: Callable[[str], _Answer]) -> _Answer:
    """Ask until the answer is understood.

    Parameters
    ----------
    understand
        Parses the stripped answer; raises `NotAnAnswerError`.

    Raises
    ------
    typer.Exit
        With code 2 at the end of the input.
    """
    while True:
        try:
            answer = input(f"{question} ")
        except EOFError:
            # Asking again would loop forever.
            typer.echo()
            raise typer.Exit(2) from None
        try:
            return understand(answer.strip())
        except NotAnAnswerError as error:
            say(str(error))


def menu(question: str, choices: Sequence[str]) -> int:
    """Ask for one of the choices, by default the first; return its index."""
    typer.echo()
    say(question)
    number(choices)
    return ask(
        "Type a number, then Enter [1]:", lambda text: _number(text or "1", len(choices)) - 1
    )


def confirm_while_recording(sentence: str, choices: Sequence[str], *, may_ask: bool = True) -> None:
    """Ask a person to confirm, by the second choice, that a running recording loses something.

    Raises
    ------
    ConfigError
        ``IN_USE`` if there is nobody to ask.
    typer.Exit
        With code 2 if the person declines.
    """
    if not (may_ask and can_ask()):
        message = f"{sentence}; end it first, or confirm that with --while-recording"
        raise ConfigError(ConfigReason.IN_USE, message)
    if menu(f"{sentence[0].upper()}{sentence[1:]}.", choices) == 0:
        raise typer.Exit(2)


def several(choices: Sequence[str], prompt: str, if_empty: Sequence[int]) -> list[int]:
    """Ask for any number of the choices; return their indices, each once.

    Parameters
    ----------
    if_empty
        Indices that Enter alone chooses.
    """
    number(choices)

    def understand(text: str) -> list[int]:
        words = text.replace(",", " ").split()
        if not words:
            return list(if_empty)
        return list(dict.fromkeys(_number(word, len(choices)) - 1 for word in words))

    return ask(prompt, understand)


def number(choices: Sequence[str]) -> None:
    """Print the choices with their numbers."""
    for index, choice in enumerate(choices, 1):
        say(f"  {index:>2}  {choice}", hang=6)


def _number(word: str, most: int) -> int:
    if word.isascii() and word.isdigit() and len(word) < 10 and 1 <= int(word) <= most:
        return int(word)
    # The answer may be long, or have control characters that must not reach the terminal.
    shown = repr(word if len(word) <= 20 else f"{word[:20]}...")
    expected = "only 1 can be chosen" if most == 1 else f"type a number from 1 to {most}"
    raise NotAnAnswerError(f"{shown} is not in the list; {expected}")


def restart_sentences(status: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence if the agent was restarted after a crash."""
    if status.get("restarts"):
        times = "once" if status["restarts"] == 1 else f"{status['restarts']} times"
        yield f"started again {times}, last after: {status['last_end']}"


def refusal_sentences(status: Mapping[str, Any]) -> Iterator[str]:
    """Yield sentences about data of an agent, a device or a stream that was dropped or changed."""
    for each in status.get("refusals", ()):
        yield each["sentence"] + ("" if each["now"] else " (not lately)")


def refused_now(status: Mapping[str, Any]) -> dict[str, str]:
    """Return sentences about data of an agent or a device that is now dropped or changed.

    Returns
    -------
    dict of str
        Sentences by a key that stays the same while the count in the sentence grows.
    """
    return {
        f"{source} {each['what']} {each.get('about', '')}": (
            f"{source}: {each['sentence']}" if source else each["sentence"]
        )
        for source, part in (("", status), *status.get("streams", {}).items())
        for each in part.get("refusals", ())
        # A pause is left out because the device's state shows it.
        if each["now"] and each["what"] != Refusal.PAUSED.word
    }


def device_sentence(device: Mapping[str, Any]) -> str:
    """Return who wears a device, its state, and its error."""
    name = " ".join(
        part for part in (device["participant"], device["sensor"], device["label"]) if part
    )
    word = STATE_WORDS.get(device["state"], device["state"])
    state = f"paused ({word})" if device["paused"] else word
    line = f"{name} ({device['unit']}): {state}"
    return line + (f" - {device['error']}" if device["error"] else "")
