"""What people read in a terminal: the table of ``run``, and lines at the bottom."""

from __future__ import annotations

import re
import threading
import tracemalloc
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_common.nonblocking_writer import NonblockingWriter
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.rate_meter import RATE_OVER_S, RateMeter
from biosensor_gateway.cli.live_table import (
    LiveTable,
    Row,
    _Lines,  # pyright: ignore[reportPrivateUsage]
    picture,
    running_foot,
)
from biosensor_gateway.devices.registry import sensor_names, sensor_title
from biosensor_gateway.system.console_lines import Line, Panel, Size
from tests.rigs.terminal import Screen

# The table of ``run``: what it says of each device, and that it fits any window.

WIDE = Size(80, 24)
REASON = "COM17: the port is in use by another program; close the program that has it open"


def table() -> LiveTable:
    return LiveTable(
        Panel(NonblockingWriter("nowhere", lambda _lines: None), lambda: None), colours=False
    )


def stream(
    pushed: int, last_stamp: float, nominal_hz: float, lost: int = 0, *, silent: bool = False
) -> dict[str, Any]:
    return {
        "pushed": pushed,
        "lost": lost,
        "last_stamp": last_stamp,
        "nominal_hz": nominal_hz,
        "silent": silent,
    }


def device(sensor: str = "polar_h10", **changes: Any) -> dict[str, Any]:
    usual: dict[str, Any] = {
        "sensor": sensor,
        "unit": "A1B2C3D4",
        "participant": "",
        "label": "",
        "state": "streaming",
        "paused": False,
        "error": None,
        "battery_percent": None,
        "streams": {},
    }
    return usual | changes


def status(*devices: dict[str, Any], at: float = 100.0) -> dict[str, Any]:
    return {"lsl_time": at, "devices": list(devices)}


def row(**changes: Any) -> Row:
    (shown,) = table().rows(status(device(**changes)))
    return shown


@pytest.mark.parametrize("state", State)
def test_every_state_has_words_for_people(state: State) -> None:
    words = row(state=state.value).state
    assert words
    assert words not in {"discovering", "enabling", "backoff"}
    assert row(state=state.value, paused=True).state == "paused"


def test_the_rate_is_that_of_the_fastest_stream_by_the_stamps_of_its_samples() -> None:
    shown = table()
    streams: dict[str, Any] = {}
    told: Row | None = None
    for second in range(4):
        # In bursts, as Bluetooth sends: what counts is when it was measured.
        streams = {
            "hr": stream(10 + second, 100.0 + second, 0),
            "acc": stream(5_000, 100.0, 500, silent=True),
            "ecg": stream(73 * (second + 1), 100.0 + 73 * (second + 1) / 130, 130),
        }
        (told,) = shown.rows(status(device(streams=streams), at=101.0 + second))
    assert told is not None
    assert told.rate == "130.0 Hz"
    # Nothing has come since.
    (told,) = shown.rows(status(device(streams=streams), at=120.0))
    assert told.rate == "-"
    streams["ecg"] |= {"pushed": 73 * 5, "last_stamp": 121.0}
    assert shown.rows(status(device(streams=streams), at=121.0))[0].rate == "-"
    streams["ecg"] |= {"pushed": 73 * 6, "last_stamp": 121.0 + 73 / 130}
    assert shown.rows(status(device(streams=streams), at=122.0))[0].rate == "130.0 Hz"


def test_a_device_without_a_rate_shows_how_often_it_tells_something() -> None:
    shown = table()
    told: Row | None = None
    for second in range(3):
        streams = {"hr": stream(1 + second, 100.0 + second, 0), "bat": stream(1, 100.0, 0)}
        (told,) = shown.rows(status(device(streams=streams), at=100.0 + second))
    assert told is not None
    assert told.rate == "1.0 Hz"


def test_losses_of_all_streams_and_the_battery() -> None:
    streams = {"ecg": stream(10, 100.0, 130, lost=73), "acc": stream(5, 100.0, 50, lost=3)}
    shown = row(streams=streams, battery_percent=86.6)
    assert (shown.lost, shown.battery) == ("76", "87 %")
    assert row().battery == "-"


@pytest.mark.parametrize(
    "away", [{"state": "discovering"}, {"state": "backoff"}, {"state": "stopped"}, {"paused": True}]
)
def test_nothing_of_before_stands_beside_a_device_that_does_not_send(away: dict[str, Any]) -> None:
    shown = table()
    told: Row | None = None
    for second in range(5):
        streams = {"ecg": stream(130 * second + 1, 100.0 + second, 130, lost=3)}
        changes: dict[str, Any] = away if second == 4 else {}
        known = device(streams=streams, battery_percent=80.0, **changes)
        (told,) = shown.rows(status(known, at=100.0 + second))
        if not changes and second:
            assert (told.rate, told.lost, told.battery) == ("130.0 Hz", "3", "80 %")
    assert told is not None
    assert (told.rate, told.lost, told.battery) == ("-", "-", "-")


def test_two_of_a_name_are_told_apart_and_others_need_no_number() -> None:
    devices = [device(), device(unit="B"), device("zephyr"), device(label="left", participant="p1")]
    title = sensor_title("polar_h10")
    assert [each.name for each in table().rows(status(*devices))] == [
        f"{title} A1B2C3D4",
        f"{title} B",
        sensor_title("zephyr"),
        f"p1 {title} left",
    ]


def drawn(rows: list[Row], size: Size = WIDE) -> list[str]:
    return [line.text for line in picture(rows, running_foot(3661), size, colours=False)]


def test_a_reason_stands_below_its_device_and_how_to_end_it_below_all() -> None:
    rows = table().rows(status(device(state="discovering", error=REASON), device("zephyr")))
    assert drawn(rows) == [
        "",
        "Device               State           Rate  Lost  Battery",
        "Polar H10            looking for it     -     -        -",
        "  COM17: the port is in use by another program; close the program that has it",
        "  open",
        "Zephyr BioHarness 3  streaming          -     0        -",
        "Running for 1:01:01. Press Ctrl-C to end it.",
        "More, in another window: biosensor-gateway status",
    ]


def test_without_a_device_it_says_so() -> None:
    assert "no device is enabled in the settings" in drawn([])


@pytest.mark.parametrize("columns", [*range(2, 40), 60, 80, 200])
@pytest.mark.parametrize("lines", [2, 3, 5, 8, 12, 24, 60])
def test_it_fits_every_window_and_names_what_is_left_out(columns: int, lines: int) -> None:
    rows = table().rows(
        status(*(device(name, state="backoff", error=REASON) for name in sensor_names()))
    )
    shown = drawn(rows, Size(columns, lines))
    assert len(shown) < lines
    if columns >= 30:
        assert max(map(len, shown)) < columns
    if columns == 80 and lines >= 8:
        named = sum(any(line.startswith(each.name) for line in shown) for each in rows)
        left_out = [line for line in shown if line.startswith("... and ")]
        assert named + sum(int(line.split()[2]) for line in left_out) == len(rows)


@pytest.mark.parametrize(
    ("state", "is_well"), [("streaming", True), ("paused", True), ("connecting", False)]
)
def test_a_device_that_is_well_has_no_colour(state: str, is_well: bool) -> None:
    row = Row("polar_h10", state, "130.0", "0", "90 %", "")
    (line,) = (each for each in picture([row], (), WIDE, colours=True) if state in each.text)
    assert (not line.colour) is is_well


def test_trouble_has_a_colour_only_where_there_are_colours() -> None:
    rows = table().rows(status(device(state="backoff", error=REASON)))
    assert any(line.colour for line in picture(rows, (), WIDE, colours=True))
    assert not any(line.colour for line in picture(rows, (), WIDE, colours=False))


def refused(sentence: str, what: str = "implausible", *, now: bool = True) -> dict[str, Any]:
    return {"what": what, "level": "warn", "sentence": sentence, "count": 2, "now": now}


def test_what_is_not_passed_on_stands_below_its_device_while_it_is_of_now() -> None:
    told = [refused("12 bytes of the device made no valid message", "garbled")]
    heart = stream(2, 100.0, 0.0) | {"refusals": [refused("2 samples were not sent: hr was 500")]}
    wind = stream(2, 100.0, 0.0) | {"refusals": [refused("it was long ago", now=False)]}
    rest = stream(2, 100.0, 0.0) | {"refusals": [refused("9 samples were withheld", "paused")]}
    streams = {"polar_h10-A-hr": heart, "polar_h10-A-ibi": wind, "polar_h10-A-ecg": rest}
    rows = table().rows(status(device(streams=streams, refusals=told)))
    assert [each.strip() for each in drawn(rows)[3:5]] == [
        "12 bytes of the device made no valid message",
        "polar_h10-A-hr: 2 samples were not sent: hr was 500",
    ]
    assert len(drawn(rows)) == 7
    assert any(line.colour for line in picture(rows, (), WIDE, colours=True)[2:])


def test_what_the_agent_itself_does_not_pass_on_stands_below_the_table() -> None:
    shown: list[str] = []
    panel = Panel(NonblockingWriter("nowhere", lambda _lines: None), lambda: None)
    panel.show = lambda drawing: shown.extend(line.text for line in drawing(WIDE))  # pyright: ignore[reportAttributeAccessIssue]
    told = refused("a marker was sent, but no program receives it", "unheard_marker")
    LiveTable(panel, colours=False).report(status(device()) | {"refusals": [told]})
    assert "a marker was sent, but no program receives it" in shown


def test_the_rate_is_that_of_the_last_seconds() -> None:
    meter = RateMeter()
    for second in range(100):
        meter.note(250 * second if second < 50 else 12_500 + 125 * (second - 50), float(second))
        rate_hz = meter.rate_hz(float(second))
        if RATE_OVER_S < second < 50:
            assert rate_hz == pytest.approx(250.0)
    assert meter.rate_hz(99.0) == pytest.approx(125.0)


def test_a_stream_whose_rate_nobody_asks_for_costs_no_memory() -> None:
    meter = RateMeter()
    tracemalloc.start()
    try:
        for second in range(50_000):
            meter.note(second, float(second))
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 100_000


# Lines at the bottom of a terminal: renewed in place, never in the way of the log.
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


@pytest.mark.parametrize(
    ("columns", "lines", "shown"),
    [(40, 2, ["one"]), (2, 12, ["o", "t"]), (40, 1, []), (1, 12, [])],
)
def test_a_window_has_room_from_two_lines_and_two_columns_on(
    columns: int, lines: int, shown: list[str]
) -> None:
    small = PanelOnScreen(columns, lines)
    small.show("one", "two")
    assert [each for each in small.screen.lines if each] == shown


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


# What ``status --watch`` says of what is not passed on: one line, however its count grows.
def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [re.sub(r"^\S+ ", "", each) for each in capsys.readouterr().out.splitlines()]


def test_a_line_tells_it_once_while_its_count_grows_and_again_after_it_was_over(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def at(*told: str) -> list[str]:
        heart = stream(2, 100.0, 0.0) | {"refusals": [refused(each) for each in told]}
        view.status(status(device(streams={"polar_h10-A-hr": heart})))
        return lines(capsys)

    view = _Lines()
    assert at() == ["polar_h10 (A1B2C3D4): streaming"]
    assert at("1 sample was not sent: hr was 500") == [
        "polar_h10-A-hr: 1 sample was not sent: hr was 500"
    ]
    assert at("12 samples were not sent: hr was 510") == []
    assert at() == []
    assert at("13 samples were not sent: hr was 510") == [
        "polar_h10-A-hr: 13 samples were not sent: hr was 510"
    ]
