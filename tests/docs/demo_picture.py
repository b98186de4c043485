"""Draw what the demo shows at its end, from a real run, as an SVG.

``python -m tests.docs.demo_picture docs/pictures/demo.svg`` (``make pictures``).
"""

from __future__ import annotations

import argparse
import errno
import os
import pty
import re
import subprocess
import sys
import termios
from collections.abc import Collection, Sequence
from io import StringIO
from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.text import Text

SECONDS = 20
LINES, COLUMNS = 100, 100
_COMMAND = "biosensor-gateway demo --seconds"
# What tells of the device or comes beside another topic; the picture has no room for it.
_LEFT_OUT = re.compile(r"\S+(?:_chunk|/(?:bat|rssi|quality|dev|eeg_status|acc|posture|activity))\b")
_SHOWN_OF_A_SENSOR, _SHOWN_REASONS = 3, 4
_AGENT, _PREFIX = "gateway/", "/biosensors/"
_NOTE = "..."

# rich's own template asks another host for its fonts.
_TEMPLATE = """\
<svg viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg" role="img">
<style>
.{unique_id}-matrix {{ font-family: "DejaVu Sans Mono", Menlo, Consolas, monospace; \
font-size: {char_height}px; line-height: {line_height}px; font-variant-east-asian: full-width }}
.{unique_id}-title {{ font-family: system-ui, "Segoe UI", sans-serif; font-size: 18px }}
{styles}
</style>
<defs><clipPath id="{unique_id}-clip-terminal">\
<rect x="0" y="0" width="{terminal_width}" height="{terminal_height}"/></clipPath>{lines}</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g></g></svg>
"""


def printed(command: Sequence[str]) -> str:
    """Return what a program prints in a terminal of the picture's width.

    Raises
    ------
    subprocess.CalledProcessError
        If it fails.
    """
    ours, its = pty.openpty()
    # Without it a table would be as wide as it likes.
    termios.tcsetwinsize(its, (LINES, COLUMNS))
    # Left in the environment, this would go before the terminal's own size.
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    with subprocess.Popen(command, stdin=its, stdout=its, env=environment) as program:
        os.close(its)
        pieces = list(iter(lambda: _read(ours), b""))
    os.close(ours)
    if program.returncode:
        raise subprocess.CalledProcessError(program.returncode, command)
    return b"".join(pieces).decode()


def _read(terminal: int) -> bytes:
    """Return what comes next; nothing once everybody has closed the other end."""
    try:
        return os.read(terminal, 1 << 16)
    except OSError as error:
        if error.errno != errno.EIO:
            raise
        return b""


def shown(text: str) -> list[str]:
    """Choose the lines of the picture from what the demo printed.

    Raises
    ------
    ValueError
        If there is no table: the demo has failed.
    """
    lines = text.splitlines()
    starts = [index for index, line in enumerate(lines) if line.startswith("topic ")]
    if not starts:
        raise ValueError("the demo printed no table")
    heading, *rest = lines[starts[-1] :]
    rows = [line for line in rest if line.strip() and not _is_reason(line)]
    reasons = [line for line in rest if _is_reason(line)]
    empty = {reason.partition(":")[0].removeprefix(_PREFIX) for reason in reasons}
    chosen = [
        row
        for _, of_sensor in groupby(rows, key=lambda row: row.partition("/")[0])
        for row in [each for each in of_sensor if _has_room(each, empty)][:_SHOWN_OF_A_SENSOR]
    ]
    more = f"{_NOTE} and {len(rows) - len(chosen)} more topics"
    rest_of_reasons = reasons[_SHOWN_REASONS:]
    others = [f"{_NOTE} and {len(rest_of_reasons)} more of them"] if rest_of_reasons else []
    return [heading, *chosen, more, *reasons[:_SHOWN_REASONS], *others]


def _has_room(row: str, empty: Collection[str]) -> bool:
    return not (_LEFT_OUT.match(row) or row.startswith(_AGENT) or row.split(maxsplit=1)[0] in empty)


def _is_reason(line: str) -> bool:
    return bool(re.match(r"/\S+: ", line))


def drawn(lines: list[str], title: str) -> str:
    """Return an SVG of a terminal with these lines; what is wider than it is cut."""
    # What rich knows of the present terminal must not change the picture.
    console = Console(
        record=True,
        width=COLUMNS,
        file=StringIO(),
        force_terminal=True,
    )
    for index, line in enumerate(lines):
        style = "bold" if not index else "dim" if _is_reason(line) or line.startswith(_NOTE) else ""
        text = Text(line, style=style)
        text.highlight_regex(r"^[/\w]+" if index else "^$", "cyan")
        console.print(text, no_wrap=True, overflow="ellipsis", crop=True)
    return console.export_svg(title=title, code_format=_TEMPLATE, unique_id="demo")


def main() -> None:
    """Run the demo and write the picture."""
    parser = argparse.ArgumentParser(description="Draw the demo from a real run.")
    parser.add_argument("picture", type=Path)
    options = parser.parse_args()
    program = Path(sys.executable).with_name("biosensor-gateway")
    text = printed([str(program), "demo", "--seconds", str(SECONDS)])
    options.picture.write_text(drawn(shown(text), f"{_COMMAND} {SECONDS}"), "utf-8")


if __name__ == "__main__":
    main()
