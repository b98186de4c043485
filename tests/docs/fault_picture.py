"""Draw how soon each sensor streams again after each fault, from the table of measurements."""

from __future__ import annotations

import re
from pathlib import Path
from xml.sax.saxutils import escape

MEASUREMENTS = Path(__file__).parents[2] / "docs" / "measurements.md"

# Up to so many seconds, and the colour of it: from "nobody notices" to "a gap in the data".
_SCALE = ((1.0, "#c8e6c9"), (3.0, "#fff3c4"), (6.0, "#ffd8a8"), (float("inf"), "#ffb4a2"))
_NONE = "#eceff1"
_LEFT, _TOP, _WIDTH, _HEIGHT, _MARGIN = 210, 64, 86, 34, 16

_STYLE = (
    "text{font-family:system-ui,'Segoe UI','DejaVu Sans',sans-serif;font-size:14px;fill:#263238}"
    ".head{font-weight:600}.value{text-anchor:middle}"
)


def rows() -> list[list[str]]:
    """Return the cells of the table, headings first.

    Raises
    ------
    ValueError
        If the page has no such table.
    """
    lines = MEASUREMENTS.read_text(encoding="utf-8").splitlines()
    starts = [index for index, line in enumerate(lines) if line.startswith("| sensor |")]
    if len(starts) != 1:
        raise ValueError(f"{MEASUREMENTS.name} has {len(starts)} tables of sensors and faults")
    table = [line for line in lines[starts[0] :] if re.match(r"\|(?!---)", line)]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def picture() -> str:
    """Return the table as an SVG whose colours tell long from short."""
    headings, *sensors = rows()
    width = _LEFT + _WIDTH * (len(headings) - 1) + _MARGIN
    height = _TOP + _HEIGHT * (len(sensors) + 1) + 2 * _MARGIN
    title = "Seconds until a sensor streams again after a fault"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">',
        f"<title>{title}</title><style>{_STYLE}</style>",
        f'<rect width="{width}" height="{height}" rx="10" fill="#f5f7f8"/>',
        _text(_MARGIN, 30, title, "head"),
        *(_text(_center(column), _TOP - 8, name, "value") for column, name in _faults(headings)),
    ]
    for row, cells in enumerate(sensors):
        y = _TOP + row * _HEIGHT
        parts.append(_text(_MARGIN, y + 22, cells[0]))
        parts += [_cell(column, y, seconds) for column, seconds in _faults(cells)]
    parts += _legend(_TOP + len(sensors) * _HEIGHT + _MARGIN)
    return "\n".join([*parts, "</svg>", ""])


def _faults(cells: list[str]) -> list[tuple[int, str]]:
    return list(enumerate(cells[1:]))


def _center(column: int) -> float:
    return _LEFT + (column + 0.5) * _WIDTH


def _text(x: float, y: float, text: str, kind: str = "") -> str:
    return f'<text x="{x:g}" y="{y:g}" class="{kind}">{escape(text)}</text>'


def _cell(column: int, y: int, seconds: str) -> str:
    x = _LEFT + column * _WIDTH
    return _box(x, y, _color(seconds)) + _text(_center(column), y + 22, seconds or "-", "value")


def _box(x: float, y: float, color: str) -> str:
    return (
        f'<rect x="{x + 1:g}" y="{y + 1:g}" width="{_WIDTH - 2}" height="{_HEIGHT - 2}" '
        f'rx="3" fill="{color}"/>'
    )


def _color(seconds: str) -> str:
    return next(color for most, color in _SCALE if float(seconds) <= most) if seconds else _NONE


def _legend(y: float) -> list[str]:
    limits = [most for most, _ in _SCALE[:-1]]
    names = [*(f"to {most:g} s" for most in limits), f"over {limits[-1]:g} s", "cannot be"]
    colors = [*(color for _, color in _SCALE), _NONE]
    return [
        _box(_LEFT + column * _WIDTH, y, color) + _text(_center(column), y + 22, name, "value")
        for column, (name, color) in enumerate(zip(names, colors, strict=True))
    ]
