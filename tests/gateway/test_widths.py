"""What people read fits a terminal of 80 columns, and says all of it."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from typing import Any

import pytest
from rich.console import Console

from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_common.terminal import wrapped
from biosensor_gateway.cli import devices, status
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.registry import declaration, declaration_names
from biosensor_gateway.doctor.device_test import DeviceTest, StreamTest
from biosensor_gateway.doctor.scan import SearchedPlace, place_of

WIDTH = 80
UNIT = "E621E1F8-C36C-495A-93FC-0C247A3E6E5F"
REASON = "COM17: the port is in use by another program; close the program that has it open"
FIGURES = {"pushed": 123456789, "lost": 98765, "refused": 43210, "withheld": 1234567}
CLOCK = {
    "offset_s": -1763806000.123456,
    "drift_ppm": -123.4,
    "residual_rms_s": 0.012345,
    "reanchors": 12345,
    "newest_s": 4711.0,
}


def device(name: str) -> dict[str, Any]:
    identity = DeviceIdentity(name, UNIT, "participant-0123", "left upper arm")
    return {
        "sensor": name,
        "unit": UNIT,
        "participant": identity.participant,
        "label": identity.label,
        "state": "discovering",
        "paused": True,
        "error": REASON,
        "clock": CLOCK,
        "streams": {
            source_id(identity, each.data_name): FIGURES for each in declaration(name).streams
        },
    }


STATUS: dict[str, Any] = {
    "written": 1.0,
    "process": 1,
    "lsl_time": 4712.0,
    "devices": [device(name) for name in declaration_names()],
}


@pytest.fixture(autouse=True)
def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """A terminal of 80 columns."""
    shown = io.StringIO()
    monkeypatch.setattr(shown, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.setenv("TERM", "dumb")
    for module in (status, devices):
        monkeypatch.setattr(module, "console", lambda: Console(width=WIDTH, file=shown))
    return shown


def fits(shown: str) -> str:
    assert shown
    assert not [line for line in shown.splitlines() if len(line.rstrip()) > WIDTH]
    return shown


def test_status(terminal: io.StringIO) -> None:
    with redirect_stdout(terminal):
        status._print_status(STATUS)  # pyright: ignore[reportPrivateUsage]
    shown = fits(terminal.getvalue())
    words = shown.split()
    for each in STATUS["devices"]:
        assert each["sensor"] in words
    assert words.count(f"({UNIT}):") == len(STATUS["devices"])
    streams = sum(len(each["streams"]) for each in STATUS["devices"])
    for figure in FIGURES.values():
        # What is lost while a device does not send is not known yet.
        assert words.count(str(figure)) == (0 if figure == FIGURES["lost"] else streams)
    assert " ".join(REASON.split()) in " ".join(words)


def test_clocks(terminal: io.StringIO) -> None:
    table = status._table(STATUS, WIDTH)  # pyright: ignore[reportPrivateUsage]
    Console(width=WIDTH, file=terminal).print(table)
    words = fits(terminal.getvalue()).split()
    assert {name for name in declaration_names() if len(name) < 20} <= set(words)
    for figure in ("-1763806000.123456", "-123.4", "12.345", "12345", "1.00"):
        assert words.count(figure) == len(STATUS["devices"])


@pytest.mark.parametrize("name", declaration_names())
def test_device_test(terminal: io.StringIO, name: str) -> None:
    streams = {
        each.data_name: StreamTest(
            samples=123456,
            first_s=1.0,
            last_s=700.0,
            last=(-1.23456e-5,) * len(each.channels),
            nominal_hz=256,
            units=tuple(channel.unit for channel in each.channels),
        )
        for each in declaration(name).streams
    }
    info = DeviceInfo(manufacturer="Manufacturer of it", model="Model 12", serial_number=UNIT)
    outcome = DeviceTest(info, streams, [REASON])
    with redirect_stdout(terminal):
        devices.print_outcome(outcome)
    words = fits(terminal.getvalue()).split()
    assert set(streams) <= set(words)
    assert UNIT in words
    channels = [channel for each in declaration(name).streams for channel in each.channels[:6]]
    units = {channel.unit for channel in channels}
    shown = {word.rstrip(",") for word in words}
    assert units - {"none"} <= shown


def test_scan(terminal: io.StringIO) -> None:
    belt = declaration_names()[-1]
    name = "a device with a name of some length, of the left upper arm"
    found = [Found(belt, name, {"device": UNIT[:-1] + end}, -71) for end in "01"]
    port = "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A10KZP45-if00-port0"
    others = tuple(f"Phone number {number}" for number in range(9))
    wired = Found(belt, "a board", {"port": port})
    places = [
        place_of("Bluetooth LE", found, others),
        place_of("Serial ports", (wired,), ()),
        SearchedPlace(where="a vendor's service", problem=REASON),
    ]
    with redirect_stdout(terminal):
        devices._print_places(places)  # pyright: ignore[reportPrivateUsage]
    lines = terminal.getvalue().splitlines()
    # Those for the settings file are to be copied as they are.
    tables = [each.toml for place in places for each in place.found]
    copied = {f"    {line}" for each in tables for line in each.splitlines()}
    assert copied <= set(lines)
    words = " ".join(fits("\n".join(line for line in lines if line not in copied)).split())
    assert words.count(f"{name}, -71 dBm") == len(found)
    assert all(other in words for other in others)
    assert REASON in words


def test_a_line_ends_between_words() -> None:
    path = "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_with_a_name_longer_than_the_whole_line_is"
    lines = wrapped(f"            fix: open {path} and {REASON}", WIDTH, hang=12).splitlines()
    assert path in [line.strip() for line in lines]
    assert all(len(line) <= WIDTH for line in lines if path not in line)
    assert " ".join(" ".join(lines).split()) == f"fix: open {path} and {REASON}"
