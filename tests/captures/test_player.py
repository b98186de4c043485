"""A capture is played in step with the driver, and tells nobody whose device it was."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Awaitable, Callable

import pytest
from bleak.uuids import normalize_uuid_16

from biosensor_gateway.captures.file import Advertised, Event
from biosensor_gateway.captures.link_player import HOLD_S, LinkPlayer
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.line_sensor import driver as line_sensor
from biosensor_gateway.system.clock import LeapingClock
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import CANCELLED, What

# A capture is played in step with the driver: no answer comes before its question.

AT = "0000aaaa-0000-1000-8000-00805f9b34fb"
QUESTION, ANSWER = "01", "f001"


def event(t: float, what: What, data: str = "", **more: object) -> Event:
    return Event.model_validate({"t": t, "link": 0, "what": what, "at": AT, "data": data, **more})


TAPE = (
    event(0.0, What.OPENED),
    event(0.5, What.WRITTEN, QUESTION, took=0.1),
    event(0.6, What.CAME, ANSWER),
    event(1.0, What.READ, "64", took=0.2),
    event(1.5, What.CAME, "aa"),
    event(2.0, What.WRITTEN, "ee"),
    event(2.5, What.CAME, "bb"),
    event(4.0, What.WRITTEN, "ee"),
    event(4.5, What.CAME, "cc"),
)


def played(
    talk: Callable[[LinkPlayer], Awaitable[object]], tape: tuple[Event, ...] = TAPE
) -> tuple[list[tuple[float, str]], LinkPlayer]:
    """Play to somebody; return what came, each with its time."""
    clock, heard = LeapingClock(100.0), list[tuple[float, str]]()

    async def play() -> LinkPlayer:
        link = LinkPlayer(
            tape, clock, 100.0, lambda each: heard.append((clock() - 100.0, each.data))
        )
        await talk(link)
        await link.is_over.wait()
        return link

    with asyncio.Runner(loop_factory=clock.new_event_loop) as runner:
        link = runner.run(play())
    return [(round(t, 3), data) for t, data in heard], link


async def as_then(link: LinkPlayer) -> None:
    await asyncio.sleep(0.5)
    await link.ask(What.WRITTEN, AT, b"\x01")
    await asyncio.sleep(0.4)
    answer = await link.ask(What.READ, AT)
    assert answer is not None
    assert answer.bytes == b"\x64"
    for _ in range(2):
        await asyncio.sleep(0.8)
        await link.ask(What.WRITTEN, AT, b"\xee")
        await asyncio.sleep(1.2)


def test_who_asks_as_then_hears_all_at_its_time() -> None:
    heard, link = played(as_then)
    assert heard == [(0.6, ANSWER), (1.5, "aa"), (2.5, "bb"), (4.5, "cc")]
    assert (link.unknown, link.unasked) == ({}, {})


def test_no_answer_comes_before_its_question() -> None:
    async def late(link: LinkPlayer) -> None:
        await asyncio.sleep(3.0)
        await link.ask(What.WRITTEN, AT, b"\x01")

    heard, link = played(late)
    assert heard[0] == (3.1, ANSWER)
    # What follows keeps its distance.
    assert heard[1] == (4.0, "aa")
    # The keeping awake is waited for once, not each time.
    assert [t for t, _ in heard[2:]] == [5.0 + HOLD_S, 7.0 + HOLD_S]
    assert link.unasked == {("written", AT): 1}


def test_who_asks_too_early_waits_for_the_time_of_then() -> None:
    async def early(link: LinkPlayer) -> None:
        await link.ask(What.WRITTEN, AT, b"\x01")

    assert played(early)[0][0] == (0.6, ANSWER)


def test_a_question_that_was_not_asked_then_is_counted() -> None:
    other = AT.replace("aaaa", "bbbb")

    async def restarted(link: LinkPlayer) -> None:
        assert await link.ask(What.READ, other) is None
        await as_then(link)

    heard, link = played(restarted)
    assert link.unknown == {("read", other): 1}
    assert len(heard) == 4


def test_a_question_in_other_words_gets_the_answer_of_then() -> None:
    async def in_other_words(link: LinkPlayer) -> None:
        await link.ask(What.WRITTEN, AT, b"\x01\x05")

    heard, link = played(in_other_words)
    assert heard[0] == (0.6, ANSWER)
    assert not link.unknown


def test_what_the_driver_gave_up_then_is_no_question() -> None:
    given_up = event(0.5, What.WRITTEN, QUESTION, error=CANCELLED)
    tape = (TAPE[0], given_up, event(1.0, What.CAME, "aa"))

    async def silent(_link: LinkPlayer) -> None:
        pass

    assert played(silent, tape)[0] == [(1.0, "aa")]


# What tells whose device it is is replaced wherever it stands, and nothing else is.
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


@pytest.mark.parametrize("number", ["7", "42", "001"])
def test_a_serial_number_too_short_to_search_for_is_replaced_where_it_is_told(number: str) -> None:
    told = number.encode() + b"\0"
    at = normalize_uuid_16(0x2A25)
    event = Event(t=0.0, link=0, what=What.READ, at=at, data=told.hex())
    (replaced,) = redacted(event, serials=(number,))
    assert replaced.bytes != told
    assert (len(replaced.bytes), replaced.bytes[-1:]) == (len(told), b"\0")


def test_a_name_with_escaped_letters_is_replaced_and_stays_json() -> None:
    pattern = re.compile(rb'"name":"((?:[^"\\]|\\.)+)"')
    told = json.dumps({"name": 'J\u00fcrgen "Joe" M\u00fcller'}, separators=(",", ":")).encode()
    (event,) = redacted(came(told), patterns=(pattern,))
    name = json.loads(event.bytes)["name"]
    assert len(name) == len('J\u00fcrgen "Joe" M\u00fcller')
    assert not {"rgen", "Joe", "ller"} & set(re.findall(r"[A-Za-z]+", name))


# As json.dumps writes it, which escapes each letter that is not ASCII, and as it is.
NAMES = (
    "\u0417\u043e\u044f",
    "\u738b\u5c0f\u660e",
    "Zo\u00eb",
    "\U00020bb7\u91ce",
    "M\u00fcller " * 20,
)


@pytest.mark.parametrize("is_escaped", [True, False])
@pytest.mark.parametrize("name", NAMES)
def test_a_name_in_any_script_is_replaced_and_stays_json(name: str, is_escaped: bool) -> None:
    told = json.dumps({"name": name, "x": 1}, ensure_ascii=is_escaped).encode()
    (event,) = redacted(came(told), patterns=line_sensor.IDENTIFIERS)
    other = json.loads(event.bytes)["name"]
    assert len(event.bytes) == len(told)
    assert [
        each for each in zip(name.split(), other.split(), strict=True) if len(set(each)) < 2
    ] == []


def test_a_letter_of_another_script_does_not_lead_back() -> None:
    advertised = (redacted(opening("\u738b"))[0].seen for _ in range(8))
    names = {each.name for each in advertised if each is not None}
    assert "\u738b" not in names
    assert len(names) > 4


@pytest.mark.parametrize(
    "told",
    [
        b"Bob\0",
        b"Bob's H10\0\0",
        b" Bob ",
        b"Zo\xeb\0",
        "Zo\u00eb".encode() + b"\0",
        b"\xff\xfeBob",
    ],
)
def test_a_short_name_is_replaced_whatever_is_around_it(told: bytes) -> None:
    at = normalize_uuid_16(0x2A00)
    (event,) = redacted(Event(t=0.0, link=0, what=What.READ, at=at, data=told.hex()))
    assert len(event.bytes) == len(told)
    assert b"Bob" not in event.bytes
    assert event.bytes.strip(b"\0 ") != told.strip(b"\0 ")


def test_a_serial_number_that_is_no_text_is_replaced() -> None:
    told = bytes.fromhex("fffe0102c3")
    at = normalize_uuid_16(0x2A25)
    (event,) = redacted(Event(t=0.0, link=0, what=What.READ, at=at, data=told.hex()))
    assert event.bytes != told
    assert len(event.bytes) == len(told)


def test_a_word_by_which_a_device_is_recognised_stays_where_it_is_read() -> None:
    at = normalize_uuid_16(0x2A00)
    read = Event(t=1.0, link=0, what=What.READ, at=at, data=b"Acme A1 12AB34CD".hex())
    redaction = Redaction(is_acme, ())
    first, second = redaction.of([opening("Acme A1 12AB34CD"), read], ())
    assert first.seen is not None
    assert second.bytes == first.seen.name.encode()
    assert redaction.left_in([first, second], "") == []


def test_the_initial_of_a_name_goes() -> None:
    pattern = re.compile(rb'"name":"([^"]+)"')
    initials = {
        redacted(came(b'{"name":"Renate"}'), patterns=(pattern,))[0].bytes[9] for _ in range(8)
    }
    assert len(initials) > 1


def test_samples_stay_as_they_are() -> None:
    samples = [came(bytes((k * 7 + j) % 256 for j in range(40))) for k in range(50)]
    assert redacted(opening("Acme"), *samples, serials=(SERIAL[::-1],))[1:] == samples
