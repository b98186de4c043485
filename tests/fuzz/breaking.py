"""Ways to break a reader, to see that its corpus finds it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Breaking = Callable[[Any], Any]
"""Makes a broken one of the sound one."""

Fault = tuple[str, str, Breaking]
"""Module or class, its attribute, and how that is broken."""


def forgets_what_it_holds(feed: Any) -> Any:
    """A parser that loses what it waits to complete."""

    def broken(parser: Any, *arguments: Any) -> Any:
        parser._buffer.clear()
        return feed(parser, *arguments)

    return broken


def always(answer: object) -> Breaking:
    """Something that says the same whatever it is asked."""

    def broken(*arguments: object) -> object:
        return answer

    return lambda sound: broken


def instead(broken: Callable[..., object]) -> Breaking:
    """Something that does another thing."""
    return lambda sound: broken
