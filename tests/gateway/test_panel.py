"""Lines at the bottom of a terminal: renewed in place, never in the way of the log."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_common.nonblocking_writer import NonblockingWriter
from biosensor_gateway.system.terminal import Line, Panel, Size
from tests.rigs.terminal import Screen

DEADLINE_S = 30.0


class PanelOnScreen:
    """A panel on a screen; the screen may take nothing for a while."""

    def __init__(self, columns: int = 40, lines: int = 12) -> None:
        self.screen = Screen(columns, lines)
        self.size: Size | None = Size(columns, lines)
        self.takes_output = threading.Event()
        self.takes_output.set()
        self.writes: list[str] = []
        self.writer = NonblockingWriter("console", self._write, most_bytes=10_000)
        self.panel = Panel(self.writer, lambda: self.size)

    def _write(self, shown: bytes) -> None:
        assert self.takes_output.wait(DEADLINE_S)
        self.writes.append(shown.decode())
        # As a terminal's driver does with the end of a line.
        self.screen.feed(shown.decode().replace("\n", "\r\n"))

    def show(self, *lines: str) -> None:
        self.panel.show(lambda _size: [Line(each) for each in lines])
        self.settle()

    def put(self, text: str) -> None:
        self.writer.put(text.encode())
        self.settle()

    def settle(self) -> None:
        assert self.writer.flush(DEADLINE_S)

    def resize(self, columns: int, lines: int) -> None:
        self.size = Size(columns, lines)
        self.screen.resize(columns, lines)


@pytest.fixture
def bench() -> PanelOnScreen:
    return PanelOnScreen()


def test_lines_of_the_log_go_above_and_the_panel_is_renewed_in_place(bench: PanelOnScreen) -> None:
    bench.show("one", "two")
    bench.put("log 1\n")
    bench.show("uno")
    bench.put("log 2\nlog 3\n")
    bench.show("eins", "zwei", "drei")
    assert bench.screen.lines == ["log 1", "log 2", "log 3", "eins", "zwei", "drei", ""]
    bench.panel.close("the end")
    bench.show("too late")
    assert bench.screen.lines == ["log 1", "log 2", "log 3", "the end", ""]


def test_a_line_that_comes_in_pieces_is_one(bench: PanelOnScreen) -> None:
    bench.show("panel")
    for piece in ("lib", "lsl ", "says", "\nand more", " of it\n\n", "last"):
        bench.put(piece)
    assert bench.screen.lines == ["liblsl says", "and more of it", "", "panel", ""]
    # Whoever does not end a line is shown with the next picture.
    bench.show("panel")
    assert bench.screen.lines == ["liblsl says", "and more of it", "", "last", "panel", ""]


def test_a_line_that_is_broken_by_the_terminal_is_not_drawn_over(bench: PanelOnScreen) -> None:
    bench.show("panel")
    bench.put("x" * 100 + "\n")
    bench.show("panel")
    assert bench.screen.lines == ["x" * 40, "x" * 40, "x" * 20, "panel", ""]


def test_what_is_wider_or_higher_than_the_terminal_is_cut(bench: PanelOnScreen) -> None:
    bench.show(*(f"{number} " + "y" * 60 for number in range(30)))
    bench.show(*(f"{number} " + "z" * 60 for number in range(30)))
    shown = bench.screen.lines
    assert shown == [(f"{number} " + "z" * 60)[:39] for number in range(11)] + [""]


def test_no_line_of_the_log_is_lost_when_the_window_becomes_narrower(bench: PanelOnScreen) -> None:
    bench.put("log 1\n")
    bench.show("a panel of some width", "second line")
    bench.resize(10, 12)
    bench.put("log 2\n")
    bench.show("a panel of some width")
    assert "log 1" in bench.screen.lines
    assert "log 2" in bench.screen.lines
    assert bench.screen.lines[-2:] == ["a panel o", ""]


def test_it_is_not_drawn_while_another_program_has_the_terminal(bench: PanelOnScreen) -> None:
    bench.size = None
    bench.show("panel")
    bench.put("log\n")
    assert "".join(bench.writes) == "log\n"


def test_a_name_cannot_command_the_terminal(bench: PanelOnScreen) -> None:
    bench.show("strap\x1b[2J\nfake")
    assert bench.screen.lines == ["strap\\x1b[2J\\nfake", ""]


def test_letters_that_take_two_columns_are_measured_so(bench: PanelOnScreen) -> None:
    bench.show("脈" * 30)
    written = bench.writes[-1].split("\x1b")[0].lstrip("\r")
    assert written == "脈" * 19 + " "


def test_letters_that_the_terminal_has_not_got_are_escaped_and_fit() -> None:
    bench = PanelOnScreen()
    Panel(bench.writer, lambda: bench.size, "ascii").show(lambda _size: [Line("é" * 39)])
    bench.settle()
    assert bench.screen.lines[0] == ("\\xe9" * 39)[:39]


def test_while_the_terminal_takes_nothing_pictures_are_left_out_and_the_log_is_not(
    bench: PanelOnScreen,
) -> None:
    bench.show("before")
    bench.takes_output.clear()
    for number in range(100):
        bench.panel.show(lambda _size, number=number: [Line(f"picture {number}")])
        if number % 10 == 0:
            bench.writer.put(f"log {number}\n".encode())
    waiting = len(bench.writes)
    bench.takes_output.set()
    bench.settle()
    # One was being written, and one stands below the last line.
    pictures = [each for each in bench.writes[waiting:] if "picture" in each]
    assert 1 <= len(pictures) <= 2
    logged = [f"log {number}" for number in range(0, 100, 10)]
    assert bench.screen.lines == [*logged, "picture 99", ""]


TEXT = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=60)
STEP = st.one_of(
    st.tuples(st.just("show"), st.lists(TEXT, max_size=15)),
    st.tuples(st.just("log"), st.integers(1, 30)),
    st.tuples(st.just("higher"), st.integers(2, 30)),
)


@settings(max_examples=60)
@given(steps=st.lists(STEP, max_size=20), columns=st.integers(2, 60))
def test_whatever_is_shown_every_line_of_the_log_stays(
    steps: Sequence[tuple[str, Sequence[str] | int]], columns: int
) -> None:
    bench = PanelOnScreen(columns)
    logged: list[str] = []
    for kind, value in steps:
        if not isinstance(value, int):
            bench.show(*([""] * len(value)))
        elif kind == "log":
            lines = [f"{len(logged) + each}" for each in range(value)]
            logged += lines
            bench.put("".join(f"{each}\n" for each in lines))
        else:
            bench.resize(columns, max(value, bench.screen.height))
    bench.panel.close()
    bench.settle()
    bench.writer.close(DEADLINE_S)
    assert "".join(bench.screen.lines) == "".join(logged)
