"""Fits the live table into a width."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from biosensor_common.terminal import shortened

Line = tuple[str, ...]
_GAP = 2
_TOPIC, _VALUE = 0, 4
_PREFIX = "/biosensors/"
_LEAST_VALUE, _LEAST_TOPIC = 12, 20


def fitted(lines: Sequence[Line], width: int) -> Sequence[Line]:
    """Return the lines of a table, the headings first, so that they fit.

    What all topics begin with goes to the heading, types become short, then values; names
    come last. Where the table fits, nothing changes.
    """
    if _total(lines) <= width:
        return lines
    headings, *rows = lines
    lines = [(f"topic in {_PREFIX}", *headings[1:]), *(_brief(row) for row in rows)]
    lines = _narrowed(lines, _VALUE, width, _LEAST_VALUE, _short_value)
    return _narrowed(lines, _TOPIC, width, _LEAST_TOPIC, shortened)


def widths(lines: Sequence[Line]) -> list[int]:
    """Return how wide each column is."""
    return [max(map(len, column)) for column in zip(*lines, strict=True)]


def _total(lines: Sequence[Line]) -> int:
    each = widths(lines)
    return sum(each) + _GAP * (len(each) - 1)


def _brief(row: Line) -> Line:
    topic, kind, *others = row
    return (
        topic.removeprefix(_PREFIX),
        kind.replace("MultiArray", "[]").replace("Array", "[]"),
        *others,
    )


def _narrowed(
    lines: Sequence[Line],
    column: int,
    width: int,
    least: int,
    shorten: Callable[[str, int], str],
) -> Sequence[Line]:
    allowed = max(least, widths(lines)[column] - max(0, _total(lines) - width))
    return [(*line[:column], shorten(line[column], allowed), *line[column + 1 :]) for line in lines]


def _short_value(text: str, width: int) -> str:
    """Keep the unit of a number, and the beginning of a text."""
    if len(text) <= width:
        return text
    words = text.split(" ")
    brief = f"{words[0]} ... {words[-1]}"
    if len(brief) <= width and not text.startswith(("{", "[")):
        return brief
    return f"{text[: width - 3]}..."
