"""What tells whose device it is is replaced wherever it stands, and nothing else is."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from bleak.uuids import normalize_uuid_16

from biosensor_gateway.captures.file import Advertised, Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import What

ADDRESS = "A0:9E:1A:12:34:5F"
SERIAL = "12345678"
CONTROL = "0000aaaa-0000-1000-8000-00805f9b34fb"


def opening(name: str = "", manufacturer: dict[int, str] | None = None) -> Event:
    seen = Advertised(address=ADDRESS, name=name, manufacturer=manufacturer or {})
    return Event(t=0.0, link=0, what=What.OPENED, seen=seen)


def came(data: bytes, at: str = CONTROL) -> Event:
    return Event(t=1.0, link=0, what=What.CAME, at=at, data=data.hex())


def is_acme(seen: Advertisement) -> bool:
    return re.fullmatch(r"Acme A\d [0-9A-F]{8}", seen.name) is not None


def nobody(_seen: Advertisement) -> bool:
    return False


def redacted(
    *events: Event,
    serials: tuple[str, ...] = (),
    recognises: Callable[[Advertisement], bool] = nobody,
    patterns: tuple[re.Pattern[bytes], ...] = (),
) -> list[Event]:
    return Redaction(recognises, patterns).of(events, serials)


@pytest.mark.parametrize(
    "spelt",
    [
        ADDRESS.encode(),
        ADDRESS.lower().encode(),
        b"A0-9E-1A-12-34-5F",
        b"A09E1A12345F",
        bytes.fromhex("A09E1A12345F"),
        bytes.fromhex("5F34121A9EA0"),
    ],
)
def test_an_address_is_replaced_in_every_spelling(spelt: bytes) -> None:
    _, event = redacted(opening(), came(b"\x01" + spelt + b"\x02"))
    inside = event.bytes[1:-1]
    assert (event.bytes[:1], event.bytes[-1:]) == (b"\x01", b"\x02")
    assert inside != spelt
    assert len(inside) == len(spelt)


def test_an_address_that_only_the_settings_know_is_replaced() -> None:
    (event,) = redacted(came(bytes.fromhex("5F34121A9EA0")), serials=(ADDRESS,))
    assert event.bytes != bytes.fromhex("5F34121A9EA0")


def test_the_same_secret_has_the_same_pseudonym_everywhere() -> None:
    first, second, third = redacted(opening(), came(ADDRESS.encode()), came(ADDRESS.encode()))
    assert first.seen is not None
    assert second.bytes.decode() == first.seen.address
    assert second.data == third.data


def test_checksums_that_add_bytes_hold() -> None:
    frame = b"\x98" + SERIAL.encode() + bytes.fromhex("A09E1A12345F")
    _, event = redacted(opening(), came(frame), serials=(SERIAL,))
    assert event.bytes != frame
    assert sum(event.bytes) % 256 == sum(frame) % 256


def test_a_serial_number_that_goes_on_in_the_next_packet_is_found() -> None:
    # As in packets of text that begin with their length.
    first, second = redacted(came(b"\x0aserial 123"), came(b"\x055678 ok"), serials=("1235678",))
    told = first.bytes[1:] + second.bytes[1:]
    assert told.startswith(b"serial 1")
    assert told.endswith(b" ok")
    assert b"1235678" not in told
    assert (first.bytes[:1], second.bytes[:1]) == (b"\x0a", b"\x05")


def test_of_a_name_only_the_words_stay_by_which_it_is_recognised() -> None:
    (event,) = redacted(opening("Acme A1 12AB34CD"), recognises=is_acme)
    assert event.seen is not None
    kind, _, rest = event.seen.name.partition(" ")
    assert kind == "Acme"
    assert is_acme(Advertisement("", event.seen.name))
    assert rest.split()[1] != "12AB34CD"


def test_a_name_of_a_person_goes_where_the_device_is_recognised_without() -> None:
    (event,) = redacted(opening("Renate's Strap"), recognises=lambda _: True)
    assert event.seen is not None
    assert not {"Renate", "Strap"} & set(re.findall(r"\w+", event.seen.name))
    assert len(event.seen.name) == len("Renate's Strap")


def test_manufacturer_data_stays_only_if_it_is_needed() -> None:
    both = {1: "aa", 2: "bb"}
    (event,) = redacted(opening("x", both), recognises=lambda seen: 2 in seen.manufacturer_data)
    assert event.seen is not None
    assert event.seen.manufacturer == {2: "bb"}


def test_what_a_driver_names_is_replaced_and_keeps_its_first_character() -> None:
    pattern = re.compile(rb'"id":"([^"]+)"')
    (event,) = redacted(came(b'{"id":"7abc 0042","bp":8}'), patterns=(pattern,))
    found = pattern.search(event.bytes)
    assert found is not None
    assert found[1][:1] == b"7"
    assert found[1] != b"7abc 0042"
    assert event.bytes.endswith(b'","bp":8}')


def test_the_standard_places_are_replaced_whoever_reads_them() -> None:
    def read(short: int, data: bytes) -> Event:
        at = normalize_uuid_16(short)
        return Event(t=0.0, link=0, what=What.READ, at=at, data=data.hex())

    name, system, serial, model = redacted(
        read(0x2A00, b"Renate"),
        read(0x2A23, bytes(range(8))),
        read(0x2A25, b"SN-4711\0"),
        read(0x2A24, b"H10"),
    )
    assert name.bytes != b"Renate"
    assert len(name.bytes) == len(b"Renate")
    assert system.bytes != bytes(range(8))
    assert serial.bytes != b"SN-4711\0"
    assert serial.bytes.endswith(b"\0")
    assert model.bytes == b"H10"


def test_samples_stay_as_they_are() -> None:
    samples = [came(bytes((k * 7 + j) % 256 for j in range(40))) for k in range(50)]
    assert redacted(opening("Acme"), *samples, serials=(SERIAL[::-1],))[1:] == samples
