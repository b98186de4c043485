"""Asks a person at a terminal, again until the answer can be understood."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

import typer

from biosensor_gateway.cli.screen import say

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
