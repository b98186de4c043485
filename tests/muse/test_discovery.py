"""Which advertisements are Muse headbands, and which preset each is told."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.muse.driver import (
    ATHENA_PRESETS,
    CLASSIC_PRESETS,
    DRIVER,
    MuseSettings,
    athena_preset,
    classic_preset,
    identify,
    model_of,
    recognise,
)
from biosensor_gateway.devices.muse.driver.protocol import Answers
from biosensor_gateway.doctor.scan import drivers_by_precedence, recognised
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from biosensor_gateway.transports.tap import What

ADDRESS = "00:55:DA:B0:3A:1F"


def seen(name: str) -> Advertisement:
    service = frozenset({"0000fe8d-0000-1000-8000-00805f9b34fb"})
    return Advertisement(ADDRESS, name, -60, service)


@pytest.mark.parametrize("name", ["Muse-3A1F", "MuseS-3A1F", "Muse Athena-3A1F"])
def test_a_headband_is_found_with_the_settings_that_lead_to_it(name: str) -> None:
    found = recognised(drivers_by_precedence(), seen(name))
    assert found is not None
    assert (found.sensor, found.name) == ("muse", name)
    settings = MuseSettings.model_validate({"sensor": found.sensor, **found.settings})
    assert (settings.unit, settings.device) == ("3A1F", ADDRESS)
    assert identify(seen(name)) == "3A1F"


@pytest.mark.parametrize("name", ["Muse", "Museum-12", "My Muse-3A1F", "Polar H10 A1B2C3D4"])
def test_anything_else_is_none(name: str) -> None:
    assert recognise(seen(name)) is None


def test_a_headband_without_a_name_is_told_by_its_service() -> None:
    found = recognised(drivers_by_precedence(), seen(""))
    assert found is not None
    assert (found.sensor, found.settings) == ("muse", {"unit": "3A1F", "device": ADDRESS})
    assert recognise(Advertisement(ADDRESS)) is None


def test_a_serial_port_is_none() -> None:
    assert recognise(SerialPort("COM7", "Muse-3A1F")) is None


@pytest.mark.parametrize("serial", ["4021-3A1F-0001", "5031-3A1F-0001", "6002-3A1F-0001", ""])
@pytest.mark.parametrize("aux", [True, False])
@pytest.mark.parametrize("ppg", [True, False])
def test_the_preset_of_a_classic_has_what_is_wanted_and_no_more(
    serial: str, aux: bool, ppg: bool
) -> None:
    sent = CLASSIC_PRESETS[classic_preset(serial, aux=aux, ppg=ppg)]
    assert (sent.has_aux, sent.light > 0) == (aux, ppg)


@pytest.mark.parametrize(
    ("aux", "light", "preset"),
    [
        (False, 0, "p21"),
        (False, 4, "p1035"),
        (False, 8, "p1034"),
        (False, 16, "p1041"),
        (True, 0, "p1045"),
        (True, 8, "p1043"),
        (True, 16, "p1041"),
    ],
)
def test_the_preset_of_an_athena_is_the_smallest_that_has_what_is_wanted(
    aux: bool, light: int, preset: str
) -> None:
    assert athena_preset(aux=aux, light=light) == preset
    assert preset in ATHENA_PRESETS


def test_the_model_is_told_by_the_serial_number() -> None:
    models = [model_of(serial) for serial in ("4021-1", "5031-1", "7001-1", "9", "")]
    assert models == ["Muse 2", "Muse S", "Muse S Athena", "", ""]


REAL = json.loads((Path(__file__).parent / "vectors" / "real_control_pieces.json").read_text())
PACKET_BYTES = 20


def packet(piece: str) -> Event:
    """Return a packet of text, which begins with its length and is filled up."""
    data = bytes([len(piece)]) + piece.encode()
    return Event(t=0.0, link=0, what=What.CAME, data=data.ljust(PACKET_BYTES, b"\0").hex())


@pytest.mark.parametrize("known", [(), ("2031-TZRW-1324",)])
def test_a_headbands_numbers_are_replaced_across_packets(known: tuple[str, ...]) -> None:
    events = [packet(piece) for piece in REAL["pieces"]]
    told = Redaction(lambda _: False, DRIVER.identifiers).of(events, known)
    answers, before = Answers(), REAL["expected"]
    complete = filter(None, [answers.feed(event.bytes) for event in told])
    status = next(each for each in complete if "sn" in each)
    own = before[3]
    for key in ("sn", "ma", "id", "hn"):
        assert status[key] != own[key]
        assert len(str(status[key])) == len(own[key])
    # By the first character of its serial number the driver knows the model.
    assert str(status["sn"])[:1] == "2"
    assert {key: status[key] for key in ("bp", "ts", "ps", "rc")} == {
        key: own[key] for key in ("bp", "ts", "ps", "rc")
    }
