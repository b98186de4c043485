"""Replaces in captured events what identifies the owner: addresses, serial numbers, names.

A pseudonym has the format of what it replaces, so that drivers parse it alike. Its bytes have the
same sum, so that additive checksums stay valid and reveal nothing new. The same secret has the same
pseudonym throughout a capture, and another one in the next capture.
"""

from __future__ import annotations

import json
import re
import secrets
import string
import unicodedata
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import accumulate
from typing import NamedTuple

from bleak.uuids import normalize_uuid_16

from biosensor_gateway.captures.file import Advertised, Event
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import What

LEAST_SEARCHED = 4
"""Bytes of the shortest text that is searched for; shorter ones would match samples by chance."""
_HEADERS = 4
"""Number of header lengths, from 0, that are tried for texts that continue in the next packet."""
_TRIES = 20_000
_LEAST_SUMMED = 6
_ADDRESS_TEXT = re.compile(rb"(?:[0-9A-Fa-f]{2}[:-]){5}[0-9A-Fa-f]{2}")
_ADDRESS = re.compile(r"(?:[0-9A-Fa-f]{2}[:-]?){5}[0-9A-Fa-f]{2}")
_WORD = re.compile(r"[^\W_]+")
_ESCAPE = re.compile(r"(\\u[Dd][89ABab]..\\u[Dd][C-Fc-f]..|\\u[0-9A-Fa-f]{4}|\\.)")
"""A character as JSON may spell it: two halves, a number, or a sign."""
_HEX = frozenset(string.hexdigits)
_NAME, _SYSTEM_ID, _SERIAL = map(normalize_uuid_16, (0x2A00, 0x2A23, 0x2A25))
_LETTERS = (string.digits, string.ascii_uppercase, string.ascii_lowercase)
_HEX_LETTERS = (string.digits, "ABCDEF", "abcdef")
_CODES = {2: range(0x80, 0x800), 3: range(0x800, 0x10000), 4: range(0x10000, 0x32000)}
"""Characters with so many bytes in UTF-8; beyond are no letters."""


class Replaced(NamedTuple):
    """Something that was replaced."""

    kind: str  # `address`, `serial number`, `name`, `identifier`, `secret`.
    # secret, pseudonym: before and after.
    secret: str
    pseudonym: str
    times: int  # How often it was found in payloads.


class Redaction:
    """Replaces identifiers in one capture.

    Parameters
    ----------
    recognises
        Whether an advertisement would still be recognized as such a device; what that needs is
        not replaced.
    patterns
        Match identifiers in payloads of this sensor, as the first group of each. A group with the
        name ``secret`` is never shown; one with the name ``address`` is six bytes, not text.
    """

    def __init__(
        self, recognises: Callable[[Advertisement], bool], patterns: Sequence[re.Pattern[bytes]]
    ) -> None:
        self._recognises = recognises
        self._patterns = (*patterns, _ADDRESS_TEXT)
        self._pseudonyms: dict[str, tuple[str, str]] = {}
        self._counts: dict[str, int] = {}
        # Words of advertised names by which devices are recognised.
        self._kept: set[str] = set()

    @property
    def replaced(self) -> list[Replaced]:
        """What was replaced so far."""
        return [
            Replaced(kind, secret, pseudonym, self._counts.get(secret, 0))
            for secret, (kind, pseudonym) in self._pseudonyms.items()
        ]

    def of(
        self,
        events: Sequence[Event],
        known: Iterable[str],
        secrets: Iterable[str] = (),
        names: Iterable[str] = (),
    ) -> list[Event]:
        """Return events with pseudonyms instead of identifiers.

        Parameters
        ----------
        known
            Serial numbers and addresses from the settings or from the driver.
        secrets
            Secrets of the driver's service.
        names
            Words of the settings that may be somebody's name.
        """
        for secret in secrets:
            self._pseudonym("secret", secret)
        for name in names:
            self._pseudonym("name", name)
        for secret in filter(None, map(self._own_part, known)):
            self._pseudonym("address" if is_address(secret) else "serial number", secret)
        redacted = [self._known_places(event) for event in events]
        by_stream: dict[tuple[int, str, What], list[int]] = {}
        for index, event in enumerate(redacted):
            by_stream.setdefault((event.link, event.at, event.what), []).append(index)
        payloads = {
            key: [bytearray(redacted[index].bytes) for index in indices]
            for key, indices in by_stream.items()
        }
        for each in payloads.values():
            self._learn(each)
        for each in payloads.values():
            self._replace(each)
        for key, indices in by_stream.items():
            for index, payload in zip(indices, payloads[key], strict=True):
                redacted[index] = redacted[index].model_copy(update={"data": payload.hex()})
        return redacted

    def left_in(self, events: Sequence[Event], text: str) -> list[Replaced]:
        """Return what should have been replaced and is still in the events or in a text."""
        by_stream: dict[tuple[int, str, What], list[bytes]] = {}
        for event in events:
            by_stream.setdefault((event.link, event.at, event.what), []).append(event.bytes)
            if event.seen is not None:
                text += event.seen.model_dump_json(exclude={"services"})
        # nothing is dropped: each length of a header is tried
        joined = [
            b"".join(packet[header:] for packet in packets)
            for packets in by_stream.values()
            for header in range(_HEADERS)
        ]
        return [
            each
            for each in self.replaced
            for before, after in _forms(each.secret, each.pseudonym)
            if before != after and any(before in place for place in (*joined, text.encode()))
        ]

    def text(self, text: str) -> str:
        """Return a text with pseudonyms for everything that is known so far."""
        for secret in sorted(self._pseudonyms, key=len, reverse=True):
            if is_searched(secret):
                text = text.replace(secret, self._pseudonyms[secret][1])
        return text

    def _known_places(self, event: Event) -> Event:
        """Replace advertisements and standard characteristics, and learn their identifiers."""
        if event.seen is not None:
            return event.model_copy(update={"seen": self._advertised(event.seen)})
        if event.what is not What.READ or event.at not in (_NAME, _SYSTEM_ID, _SERIAL):
            return event
        content = event.bytes
        told = content.strip(b"\0 ")
        text, encoding = _decoded(told)
        if event.at == _SYSTEM_ID or not text:
            # Other bytes than text are not searched for; padding alone says nothing.
            data = secrets.token_bytes(len(content)) if told else content
        elif event.at == _NAME:
            replaced = self._name(text, Advertisement(""))
            data = content.replace(told, replaced.encode(encoding))
        else:
            # Longer ones are replaced wherever they are.
            pseudonym = self._pseudonym("serial number", text)
            is_short = not is_searched(text)
            data = content.replace(told, pseudonym.encode(encoding)) if is_short else content
        return event.model_copy(update={"data": data.hex()})

    def _advertised(self, seen: Advertised) -> Advertised:
        original = _advertisement(seen)
        is_known = self._recognises(original)
        manufacturer = dict(seen.manufacturer)
        for company in seen.manufacturer:
            rest = {each: data for each, data in manufacturer.items() if each != company}
            trial = seen.model_copy(update={"manufacturer": rest})
            if not is_known or self._recognises(_advertisement(trial)):
                manufacturer = rest
        address = self._pseudonym("address", seen.address)
        name = self._name(seen.name, original)
        update = {"address": address, "name": name, "manufacturer": manufacturer}
        return seen.model_copy(update=update)

    def _name(self, name: str, seen: Advertisement) -> str:
        """Replace each word of a name that is not needed to recognize the device."""
        is_known = self._recognises(seen)
        kept = set(_WORD.findall(seen.name if is_known else ""))
        for word in sorted(set(_WORD.findall(name)) - self._kept, key=len, reverse=True):
            pseudonym = self._pseudonyms.get(word, ("", _like(word)))[1]
            trial = _with_word(name, word, pseudonym)
            fits = self._recognises(
                Advertisement(seen.address, trial, None, seen.service_uuids, seen.manufacturer_data)
            )
            if not is_known or fits:
                name = trial
                self._pseudonyms.setdefault(word, ("name", pseudonym))
                kept.discard(word)
        self._kept |= kept
        return name

    def _own_part(self, secret: str) -> str:
        """Return a serial number without its model-specific part, if a pattern knows it."""
        for pattern in self._patterns:
            found = pattern.fullmatch(secret.encode())
            if found is not None and found.re.groups:
                return found[1].decode()
        return secret

    def _pseudonym(self, kind: str, secret: str) -> str:
        known = self._pseudonyms.get(secret)
        if known is None:
            # The first character of a serial number often identifies the model for drivers; that
            # of a person's name stands for the person.
            is_number = kind in ("serial number", "identifier") and any(
                map(str.isdigit, _unescaped(secret))
            )
            is_number = is_number and is_searched(secret) and secret[0].isalnum()
            kept = secret[:1] if is_number else ""
            known = self._pseudonyms[secret] = kind, _like(secret, kept)
        return known[1]

    def _learn(self, payloads: Sequence[bytearray]) -> None:
        """Find identifiers by the patterns, including those that are split over two packets."""
        for header in range(_HEADERS):
            text = b"".join(payload[header:] for payload in payloads)
            for pattern in self._patterns:
                for found in pattern.finditer(text):
                    secret = _spelt(found)
                    kind = "secret" if "secret" in pattern.groupindex else "identifier"
                    # An identifier of equal characters, such as zeros, identifies nothing.
                    identifies = len(set(_bare(secret))) > 1
                    if identifies and _bare(secret) not in map(_bare, self._pseudonyms):
                        self._pseudonym(kind, secret)

    def _replace(self, payloads: Sequence[bytearray]) -> None:
        for header in range(_HEADERS):
            pieces = [bytes(payload[header:]) for payload in payloads]
            ends = list(accumulate(map(len, pieces)))
            text = bytearray().join(pieces)
            for secret in sorted(self._pseudonyms, key=len, reverse=True):
                for before, after in _forms(secret, self._pseudonyms[secret][1]):
                    for position in _positions(text, before):
                        # A shorter secret that is part of this one is not found in it again.
                        text[position : position + len(after)] = after
                        self._counts[secret] = self._counts.get(secret, 0) + 1
                        for offset, byte in enumerate(after, position):
                            piece = bisect_right(ends, offset)
                            begin = ends[piece] - len(pieces[piece])
                            payloads[piece][header + offset - begin] = byte


def is_address(text: str) -> bool:
    """Whether a text is a MAC address."""
    return _ADDRESS.fullmatch(text) is not None


def _advertisement(seen: Advertised) -> Advertisement:
    manufacturer = {each: bytes.fromhex(data) for each, data in seen.manufacturer.items()}
    return Advertisement(
        seen.address, seen.name, seen.rssi_dbm, frozenset(seen.services), manufacturer
    )


def is_searched(secret: str) -> bool:
    """Whether a text is long enough to be searched for in payloads."""
    return len(secret.encode()) >= LEAST_SEARCHED


def _spelt(found: re.Match[bytes]) -> str:
    """Return an identifier as text; empty if it is none.

    One with a packet's header in the middle is none, and is found with another header length.
    """
    if "address" in found.re.groupindex:
        return found["address"].hex(":")
    return _decoded(found[found.re.groups and 1])[0]


def _decoded(content: bytes) -> tuple[str, str]:
    """Return printable text with its encoding, which old devices do not tell; or an empty one."""
    for encoding in ("utf-8", "latin-1"):
        text = content.decode(encoding, "replace")
        if text.isprintable() and "\ufffd" not in text:
            return text, encoding
    return "", ""


def _with_word(name: str, word: str, other: str) -> str:
    return _WORD.sub(lambda found: other if found[0] == word else found[0], name)


def _forms(secret: str, pseudonym: str) -> Iterator[tuple[bytes, bytes]]:
    """Yield the encodings of a secret in payloads, each with that of its pseudonym."""
    if not is_searched(secret):
        # nothing is dropped: a word so short is replaced where it is told
        return
    bare = [_bare(each) for each in (secret, pseudonym)]
    spelt = [(secret, pseudonym)]
    if is_address(secret):
        spelt += [_joined(bare, mark) for mark in ("", ":", "-")]
    if not secret.isascii():
        spelt.append((json.dumps(secret)[1:-1], json.dumps(pseudonym)[1:-1]))
    elif "\\u" in secret:
        spelt.append((_unescaped(secret), _unescaped(pseudonym)))
    forms = {
        change(before).encode(encoding, "replace"): change(after).encode(encoding, "replace")
        for before, after in spelt
        for change in (str, str.upper, str.lower)
        for encoding in ("utf-8", "latin-1")
        if encoding == "utf-8" or max(before) < "\u0100"
    }
    if is_address(secret):
        before, after = (bytes.fromhex(each) for each in bare)
        forms |= {before: after, before[::-1]: after[::-1]}
    # A few letters become longer as capitals.
    yield from ((before, after) for before, after in forms.items() if len(before) == len(after))


def _bare(address: str) -> str:
    return re.sub("[:-]", "", address).upper()


def _joined(texts: Sequence[str], mark: str) -> tuple[str, str]:
    first, second = (mark.join(re.findall("..", each)) for each in texts)
    return first, second


def _positions(text: bytes | bytearray, wanted: bytes) -> Iterator[int]:
    position = text.find(wanted)
    while position >= 0:
        yield position
        position = text.find(wanted, position + len(wanted))


def _like(secret: str, kept: str = "") -> str:
    """Return a random text of the same format, and with the same sum of bytes if possible.

    Parameters
    ----------
    kept
        Beginning that is not changed.
    """
    words = "".join(_WORD.findall(secret))
    is_hex = set(words) <= _HEX and any(map(str.isdigit, words))
    classes = _HEX_LETTERS if is_hex else _LETTERS
    rest = secret[len(kept) :]
    candidate = secret
    for _ in range(_TRIES):
        if is_address(secret):
            candidate = kept + _address_like(secret)[len(kept) :]
        else:
            candidate = kept + "".join(_drawn(each, classes) for each in _ESCAPE.split(rest))
        # The sum of a short text would reveal too much.
        is_alike = len(secret) < _LEAST_SUMMED or _sums(candidate) == _sums(secret)
        if candidate != secret and is_alike:
            return candidate
    return candidate


def _address_like(address: str) -> str:
    """Return a random address of the same format, whose six bytes have the same sum."""
    octets = secrets.token_bytes(5)
    last = (sum(bytes.fromhex(_bare(address))) - sum(octets)) % 256
    digits = iter((octets + bytes([last])).hex().upper())
    drawn = "".join(each if each in ":-" else next(digits) for each in address)
    return drawn.lower() if address == address.lower() else drawn


def _drawn(piece: str, classes: Sequence[str]) -> str:
    if not piece.startswith("\\"):
        return "".join(_letter(each, classes) for each in piece)
    if not piece.startswith("\\u"):
        return piece
    halves = _letter(_unescaped(piece), classes).encode("utf-16-be", "surrogatepass").hex()
    return re.sub("....", r"\\u\g<0>", halves)


def _unescaped(text: str) -> str:
    """Return a text without the escapes of JSON that are numbers."""
    return re.sub(
        r"(?:\\u[0-9A-Fa-f]{4})+",
        lambda found: bytes.fromhex(found[0].replace("\\u", "")).decode("utf-16-be", "replace"),
        text,
    )


def _letter(letter: str, classes: Sequence[str]) -> str:
    letters = next((each for each in classes if letter in each), "")
    if not letters and not letter.isascii() and letter.isprintable():
        letters = _kindred(_kind(letter), len(letter.encode()), letter < "\u0100")
    return secrets.choice(letters) if letters else letter


@cache
def _kindred(kind: str, size: int, is_latin_1: bool) -> str:
    """Return the characters of a kind that have as many bytes, also as capitals."""
    return "".join(
        letter
        for letter in map(chr, _CODES[size])
        if letter.isprintable()
        and (letter < "\u0100") == is_latin_1
        and _kind(letter) == kind
        and len(letter.upper().encode()) == len(letter.lower().encode()) == size
    )


def _kind(letter: str) -> str:
    """Return the script of a letter, the category of another character."""
    if letter.isalpha():
        return unicodedata.name(letter, "").partition(" ")[0]
    return unicodedata.category(letter)


def _sums(text: str) -> tuple[int, ...]:
    """Return the sums, modulo 256, of a text's bytes and of the bytes that an address means."""
    sums = [sum(text.encode()) % 256]
    if is_address(text):
        sums.append(sum(bytes.fromhex(_bare(text))) % 256)
    return tuple(sums)
