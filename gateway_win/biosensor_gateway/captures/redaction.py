"""Replaces in captured events what identifies the owner: addresses, serial numbers, names.

A pseudonym has the format of what it replaces, so that drivers parse it alike. Its bytes have the
same sum, so that additive checksums stay valid and reveal nothing new. The same secret has the same
pseudonym throughout a capture, and another one in the next capture.
"""

from __future__ import annotations

import re
import secrets
import string
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import accumulate
from typing import NamedTuple

from bleak.uuids import normalize_uuid_16

from biosensor_gateway.captures.file import Advertised, Event
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import What

LEAST_SEARCHED = 4
"""Length of the shortest text that is searched for; shorter ones would match samples by chance."""
_HEADERS = 4
"""Number of header lengths, from 0, that are tried for texts that continue in the next packet."""
_TRIES = 20_000
_LEAST_SUMMED = 6
_ADDRESS_BYTES = 6
_ADDRESS_TEXT = re.compile(rb"(?:[0-9A-Fa-f]{2}[:-]){5}[0-9A-Fa-f]{2}")
_ADDRESS = re.compile(r"(?:[0-9A-Fa-f]{2}[:-]?){5}[0-9A-Fa-f]{2}")
_WORD = re.compile(r"[^\W_]+")
_ESCAPE = re.compile(r"(\\(?:u[0-9A-Fa-f]{4}|.))")
"""A character as JSON may spell it, which stays, because another one may be no JSON."""
_HEX = frozenset(string.hexdigits)
_NAME, _SYSTEM_ID, _SERIAL = map(normalize_uuid_16, (0x2A00, 0x2A23, 0x2A25))
_LETTERS = (string.digits, string.ascii_uppercase, string.ascii_lowercase)
_HEX_LETTERS = (string.digits, "ABCDEF", "abcdef")


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
        Match identifiers in payloads of this sensor, as the first group of each.
    """

    def __init__(
        self, recognises: Callable[[Advertisement], bool], patterns: Sequence[re.Pattern[bytes]]
    ) -> None:
        self._recognises = recognises
        self._patterns = (*patterns, _ADDRESS_TEXT)
        self._pseudonyms: dict[str, tuple[str, str]] = {}
        self._counts: dict[str, int] = {}

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
            if len(secret) >= LEAST_SEARCHED:
                text = text.replace(secret, self._pseudonyms[secret][1])
        return text

    def _known_places(self, event: Event) -> Event:
        """Replace advertisements and standard characteristics, and learn their identifiers."""
        if event.seen is not None:
            return event.model_copy(update={"seen": self._advertised(event.seen)})
        if event.what is not What.READ or event.at not in (_NAME, _SYSTEM_ID, _SERIAL):
            return event
        content = event.bytes
        if event.at == _SYSTEM_ID:
            return event.model_copy(update={"data": secrets.token_hex(len(content))})
        text = content.decode("utf-8", "replace").strip("\0 ")
        if text and event.at == _SERIAL:
            pseudonym = self._pseudonym("serial number", text)
            if len(text) < LEAST_SEARCHED:
                data = content.replace(text.encode(), pseudonym.encode())
                return event.model_copy(update={"data": data.hex()})
        elif text:
            replaced = self._name(text, Advertisement("")).encode()
            data = replaced if len(replaced) == len(content) else content
            return event.model_copy(update={"data": data.hex()})
        return event

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
        for word in sorted(set(_WORD.findall(name)), key=len, reverse=True):
            pseudonym = self._pseudonyms.get(word, ("", _like(word)))[1]
            trial = _with_word(name, word, pseudonym)
            fits = self._recognises(
                Advertisement(seen.address, trial, None, seen.service_uuids, seen.manufacturer_data)
            )
            if not is_known or fits:
                name = trial
                self._pseudonyms.setdefault(word, ("name", pseudonym))
                kept.discard(word)
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
            # The first character of a serial number often identifies the model for drivers.
            is_number = kind in ("serial number", "identifier") and len(secret) >= LEAST_SEARCHED
            kept = secret[:1] if is_number else ""
            known = self._pseudonyms[secret] = kind, _like(secret, kept)
        return known[1]

    def _learn(self, payloads: Sequence[bytearray]) -> None:
        """Find identifiers by the patterns, including those that are split over two packets."""
        for header in range(_HEADERS):
            text = b"".join(payload[header:] for payload in payloads)
            for pattern in self._patterns:
                for found in pattern.finditer(text):
                    secret = _spelt(found[found.re.groups and 1])
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


def _spelt(found: bytes) -> str:
    """Return an identifier as text, or an address of six bytes; empty if it is neither.

    One with a packet's header in the middle is neither, and is found with another header length.
    """
    text = found.decode("ascii", "replace")
    if text.isprintable() and "\ufffd" not in text:
        return text
    return found.hex(":") if len(found) == _ADDRESS_BYTES else ""


def _with_word(name: str, word: str, other: str) -> str:
    return _WORD.sub(lambda found: other if found[0] == word else found[0], name)


def _forms(secret: str, pseudonym: str) -> Iterator[tuple[bytes, bytes]]:
    """Yield the encodings of a secret in payloads, each with that of its pseudonym."""
    if len(secret) < LEAST_SEARCHED:
        # nothing is dropped: a word so short is replaced where it is told
        return
    bare = [_bare(each) for each in (secret, pseudonym)]
    spelt = [(secret, pseudonym)]
    if is_address(secret):
        spelt += [_joined(bare, mark) for mark in ("", ":", "-")]
    forms = {
        change(before).encode(): change(after).encode()
        for before, after in spelt
        for change in (str, str.upper, str.lower)
    }
    if is_address(secret):
        before, after = (bytes.fromhex(each) for each in bare)
        forms |= {before: after, before[::-1]: after[::-1]}
    yield from forms.items()


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
    return piece if piece.startswith("\\") else "".join(_letter(each, classes) for each in piece)


def _letter(letter: str, classes: Sequence[str]) -> str:
    letters = next((each for each in classes if letter in each), "")
    if not letters and letter.isalpha():
        # A letter of another script is replaced by one with as many bytes.
        return letter if len(letter.encode()) == 1 else chr(ord(letter) ^ 1)
    return secrets.choice(letters) if letters else letter


def _sums(text: str) -> tuple[int, ...]:
    """Return the sums, modulo 256, of a text's bytes and of the bytes that an address means."""
    sums = [sum(text.encode()) % 256]
    if is_address(text):
        sums.append(sum(bytes.fromhex(_bare(text))) % 256)
    return tuple(sums)
