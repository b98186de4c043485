"""Finds the traces of a person in files, and rewrites text files, EDF and BDF without them."""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import json
import re
import sys
import unicodedata
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from biosensor_common.naming import label, sanitise
from biosensor_gateway.system.new_file import new_file

INSTEAD = "withdrawn"
"""Replaces the person's name in texts about others."""
_ENCODINGS = ("utf-8", "cp1252", "utf-16-le", "utf-16-be")


TABLES = (".csv", ".tsv", ".csv.gz", ".tsv.gz")
NOTES = (".txt", ".md", ".log", ".vmrk", ".vhdr")
LONGEST_JSON = 64_000_000
EDF = (".bdf", ".edf")
_HEAD, _HEAD_OF_SIGNAL = 256, 256
_LABEL = 16
# Bytes of each signal before the fields: least and greatest value, least and greatest number, and
# samples in a record.
_BEFORE_NUMBERS = (104, 112, 120, 128, 216)
_BLOCK_BYTES = 1 << 20


def _key(name: str) -> str:
    """Return a key that is equal for all spellings of a name: its case and form of accents."""
    return unicodedata.normalize("NFC", name).casefold()


def _spellings(name: str) -> set[str]:
    """Return the spellings of a name: each form of accents and, beyond ASCII, each case."""
    forms = {unicodedata.normalize(each, name) for each in ("NFC", "NFD")}
    return forms | {each for form in forms for each in (form.lower(), form.upper(), form.title())}


def _escaped(name: str) -> set[str]:
    """Return a name as escaped in JSON, XML, LSL names and topics, where that differs."""
    codes = [[f"&#{ord(c)};", f"&#x{ord(c):X};"] for c in name]
    as_xml = [
        "".join(c if c.isascii() else code[kind] for c, code in zip(name, codes, strict=True))
        for kind in (0, 1)
    ]
    as_file = "".join(
        c if c.isascii() and c.isalnum() else "".join(f"_x{byte:02X}" for byte in c.encode())
        for c in name
    )
    return {json.dumps(name)[1:-1], sanitise(name), as_file.strip("_"), *as_xml}


# Characters next to a part of an escaped name of a stream or topic.
_ESCAPE_BEFORE = re.compile(r"x[0-9A-F]{2}_$")
_ESCAPE_BEHIND = re.compile(r"_x[0-9A-F]{2}")
# The same where "P1_x10" may also be a text of its own: letters beyond ASCII only.
_LETTERS_BEFORE = re.compile(r"x[C-F][0-9A-F](_x[89AB][0-9A-F]){1,3}_$")
_LETTERS_BEHIND = re.compile(r"_x[C-F][0-9A-F]")
_LONGEST_ESCAPE = 16


class Person:
    """The withdrawing person, with all forms of the name in files.

    Case is ignored, because a reader recognises the name in any case. Other names of which it is a
    part, or which only have the same BIDS label, are other people's.

    Parameters
    ----------
    shares_label
        Whether somebody else has the BIDS label of this person, as Muller and Müller.
    """

    def __init__(self, name: str, *, shares_label: bool = False) -> None:
        self.name, self._key = name, _key(name)
        self._label = label(name).lower()
        spelt = _spellings(name)
        forms = {*spelt, *(each for form in spelt for each in _escaped(form))}
        if not shares_label:
            forms.add(f"sub-{self._label}")
        self.owns_label = not shares_label
        # The longest first, for one may begin with another.
        every = sorted(forms, key=lambda each: (-len(each), each))
        self._text = re.compile("|".join(map(re.escape, every)), re.IGNORECASE)
        self._patterns = [
            (encoding, re.compile(b"|".join(re.escape(each) for each in found), re.IGNORECASE))
            for encoding in _ENCODINGS
            if (found := list(_encoded(every if encoding == "utf-8" else spelt, encoding)))
        ]

    def is_called(self, participant: str) -> bool:
        """Whether a participant is this person."""
        return bool(participant) and _key(participant) == self._key

    def has_label(self, participant: str) -> bool:
        """Whether the BIDS label of this person, and maybe of others, equals that of a text."""
        return bool(participant) and label(participant).lower() == self._label

    @property
    def is_label(self) -> bool:
        """Whether the name equals its BIDS label, so that no other name has the same label."""
        return self._key == self._label

    def is_in(self, text: str) -> bool:
        """Whether a text contains the name."""
        return next(self._in_text(text), None) is not None

    def is_in_name(self, name: str) -> bool:
        """Whether the name of a stream or topic contains the name, not only an escaped part."""
        return any(
            not (_ESCAPE_BEFORE.search(name[:begin]) or _ESCAPE_BEHIND.match(name, end))
            for begin, end in self._in_text(name)
        )

    def is_in_bytes(self, content: bytes) -> bool:
        """Whether bytes contain the name."""
        return next(self.places(content), None) is not None

    def places(self, content: bytes) -> Iterator[tuple[int, int]]:
        """Yield the range of each occurrence of the name, with the end excluded."""
        for encoding, pattern in self._patterns:
            for found in pattern.finditer(content):
                begin, end = found.span()
                before = content[max(0, begin - _LONGEST_ESCAPE) : begin].decode(encoding, "ignore")
                behind = content[end : end + _LONGEST_ESCAPE].decode(encoding, "ignore")
                if _stands_alone(before, behind):
                    yield begin, end

    def blanked(self, content: bytes) -> bytes:
        """Return bytes with each letter of the name replaced by an x."""
        blanked = bytearray(content)
        for begin, end in self.places(content):
            blanked[begin:end] = b"x" * (end - begin)
        return bytes(blanked)

    def masked(self, text: str) -> str:
        """Return a text with the name replaced."""
        masked, done = "", 0
        for begin, end in self._in_text(text):
            masked, done = masked + text[done:begin] + INSTEAD, end
        return masked + text[done:]

    def _in_text(self, text: str) -> Iterator[tuple[int, int]]:
        for found in self._text.finditer(text):
            begin, end = found.span()
            if _stands_alone(
                text[max(0, begin - _LONGEST_ESCAPE) : begin], text[end : end + _LONGEST_ESCAPE]
            ):
                yield begin, end

    def pruned(self, content: object) -> object:
        """Return JSON content without the person's data; None if nothing is left.

        Objects of the participant are removed completely, as are keys and list items that contain
        the name; in other texts the name is replaced.
        """
        if isinstance(content, dict):
            told = cast("dict[str, object]", content)
            if any(self.is_called(str(told.get(key, ""))) for key in ("participant", "wearer")):
                return None
            kept = {key: self.pruned(each) for key, each in told.items() if not self.is_in(key)}
            return {
                key: each for key, each in kept.items() if each is not None or told[key] is None
            }
        if isinstance(content, list):
            pruned = [
                self.pruned(each)
                for each in cast("list[object]", content)
                if not (isinstance(each, str) and self.is_in(each))
            ]
            return [each for each in pruned if each is not None]
        return self.masked(content) if isinstance(content, str) else content


def _encoded(forms: Iterable[str], encoding: str) -> Iterator[bytes]:
    """Yield texts in an encoding, if it can have them and UTF-8 has them otherwise."""
    for each in forms:
        content = each.encode(encoding, "ignore")
        is_other = encoding == "utf-8" or content != each.encode("utf-8", "ignore")
        # A single letter in two bytes is in any data.
        if is_other and content.decode(encoding) == each and len(each) > ("16" in encoding):
            yield content


# A letter as JSON and XML have it without other characters than ASCII.
_LETTER = r"(?:\\u([0-9A-Fa-f]{4})|&#x([0-9A-Fa-f]{1,6});|&#([0-9]{1,7});)"
_LETTER_BEFORE, _LETTER_BEHIND = re.compile(_LETTER + "$"), re.compile(_LETTER)


def _stands_alone(before: str, behind: str) -> bool:
    """Whether a name is not part of a longer one, by the letters, digits and accents next to it."""
    before = _letter_of(_LETTER_BEFORE.search(before)) or before
    behind = _letter_of(_LETTER_BEHIND.match(behind)) or behind
    is_escaped = _LETTERS_BEFORE.search(before) or _LETTERS_BEHIND.match(behind)
    is_part = before[-1:].isalnum() or behind[:1].isalnum() or is_escaped is not None
    return not (is_part or unicodedata.combining(behind[:1] or " "))


def _letter_of(escaped: re.Match[str] | None) -> str:
    if escaped is None:
        return ""
    in_json, in_hex, in_xml = escaped.groups()
    code = int(in_json or in_hex, 16) if in_json or in_hex else int(in_xml)
    return chr(code) if code <= sys.maxunicode else ""


def is_table(path: Path) -> bool:
    """Whether it is a table, compressed or not."""
    return path.name.lower().endswith(TABLES)


def is_text(path: Path) -> bool:
    """Whether lines or objects can be removed from it."""
    return is_table(path) or path.suffix.lower() in (*NOTES, ".json")


def open_plain(path: Path) -> BinaryIO:
    """Open a file, decompressing it if needed."""
    with path.open("rb") as file:
        is_packed = file.read(2) == b"\x1f\x8b"
    return gzip.open(path, "rb") if is_packed else path.open("rb")  # type: ignore[return-value]


def is_utf16(path: Path) -> bool:
    """Whether a file begins like a Windows text with two bytes for each character."""
    with open_plain(path) as file:
        return file.read(2) in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def lines_of(path: Path, person: Person) -> int:
    """Return the number of lines in a file that name a person."""
    with open_plain(path) as file:
        return sum(person.is_in_bytes(each) for each in _rows(file, path))


def write_without(path: Path, target: Path, person: Person) -> None:
    """Copy it without the lines, or JSON objects, that name a person.

    Raises
    ------
    OSError
        If it cannot be read or written.
    ValueError
        If JSON cannot be read.
    """
    columns = columns_of(path, person)
    with open_plain(path) as file, new_file(target, like=path) as new:
        kept = _kept(file, path, person)
        if path.suffix == ".json":
            kept = _of_json(file, person)
        elif columns is not None:
            kept = _without_columns(file, path, person, columns)
        if path.suffix == ".gz":
            with gzip.GzipFile("", "wb", 4, new, mtime=0) as packed:
                packed.writelines(kept)
        else:
            new.writelines(kept)


def columns_of(path: Path, person: Person) -> list[int] | None:
    """Return which columns of a table that others are in, too, are a person's; None elsewhere."""
    if not is_table(path):
        return None
    try:
        with open_plain(path) as file:
            heads = next(_cells(_rows(file, path), path), [""])
    except csv.Error:
        return None
    own = [at for at, head in enumerate(heads) if person.is_in(head)]
    is_wide = bool(_WIDE.match(path.name))
    return own if is_wide or 0 < len(own) < len(heads) else None


_WIDE = re.compile(r"all_[^_]*Hz\.")


def _without_columns(
    file: BinaryIO, path: Path, person: Person, columns: list[int]
) -> Iterator[bytes]:
    """Yield the rows, each of which may have others' samples: texts in them lose the name."""
    for row in _cells(_rows(file, path), path):
        text = io.StringIO()
        kept = [person.masked(each) for at, each in enumerate(row) if at not in columns]
        csv.writer(text, delimiter=_delimiter(path), lineterminator="\n").writerow(kept)
        yield text.getvalue().encode("utf-8", "surrogateescape")


def _cells(rows: Iterable[bytes], path: Path) -> Iterator[list[str]]:
    texts = (each.decode("utf-8", "surrogateescape") for each in rows)
    return iter(csv.reader(texts, delimiter=_delimiter(path)))


def _delimiter(path: Path) -> str:
    return "\t" if ".tsv" in path.name.lower() else ","


def _of_json(file: BinaryIO, person: Person) -> Iterator[bytes]:
    pruned = person.pruned(json.loads(file.read(LONGEST_JSON).decode("utf-8", "replace")))
    yield (json.dumps(pruned, indent=2, ensure_ascii=False) + "\n").encode()


def _kept(file: BinaryIO, path: Path, person: Person) -> Iterator[bytes]:
    return (each for each in _rows(file, path) if not person.is_in_bytes(each))


def _rows(lines: Iterable[bytes], path: Path) -> Iterator[bytes]:
    """Yield the rows of a table; a quoted cell may span several lines."""
    if ".csv" not in path.name.lower():
        yield from lines
        return
    row = b""
    for line in lines:
        row += line
        if row.count(b'"') % 2 == 0:
            yield row
            row = b""
    if row:
        yield row


class Signal(NamedTuple):
    """A signal in an EDF or BDF file: its place in each record, and its scale."""

    begin: int
    end: int
    step: float
    least: float  # The value of the number 0.


class Layout(NamedTuple):
    """The places of text in an EDF or BDF file: its header, and parts of each record."""

    head: int
    record: int
    spans: tuple[tuple[int, int], ...]
    signals: tuple[Signal, ...]


def layout_of(file: BinaryIO, path: Path) -> Layout:
    """Read the header of a file.

    Raises
    ------
    ValueError
        If it is neither EDF nor BDF.
    """
    file.seek(0)
    head = file.read(_HEAD)
    count = int(head[252:256])
    signals = file.read(count * _HEAD_OF_SIGNAL)
    width = 3 if path.suffix.lower() == ".bdf" else 2
    begin = 0
    spans: list[tuple[int, int]] = []
    found: list[Signal] = []
    for number in range(count):
        label = signals[number * _LABEL : (number + 1) * _LABEL]
        *scale, samples = (
            float(signals[count * before + number * 8 :][:8]) for before in _BEFORE_NUMBERS
        )
        end = begin + width * int(samples)
        if label.strip().endswith(b"Annotations"):
            spans.append((begin, end))
        else:
            least, most, digital_least, digital_most = scale
            step = (most - least) / (digital_most - digital_least or 1.0)
            found.append(Signal(begin, end, step, least - step * digital_least))
        begin = end
    return Layout(_HEAD + count * _HEAD_OF_SIGNAL, begin, tuple(spans), tuple(found))


def signals_of_edf(path: Path, overlap: int) -> Iterator[tuple[NDArray[np.float64], float]]:
    """Yield parts of each signal, and by how much its values are rounded.

    Parameters
    ----------
    overlap
        Number of samples of the part before, with which a part begins.

    Raises
    ------
    ValueError
        If it is neither EDF nor BDF.
    """
    width = 3 if path.suffix.lower() == ".bdf" else 2
    with path.open("rb") as file:
        layout = layout_of(file, path)
        file.seek(layout.head)
        size = max(1, _BLOCK_BYTES // max(1, layout.record)) * layout.record
        before: list[NDArray[np.float64]] = [np.empty(0)] * len(layout.signals)
        while size and (content := file.read(size)):
            whole = len(content) // layout.record * layout.record
            records = np.frombuffer(content[:whole], np.uint8).reshape(-1, layout.record)
            for at, each in enumerate(layout.signals):
                counts = np.zeros((records[:, each.begin : each.end].size // width, 4), np.uint8)
                counts[:, 4 - width :] = records[:, each.begin : each.end].reshape(-1, width)
                digital = (counts.view("<i4")[:, 0] >> 8 * (4 - width)).astype(np.float64)
                part = np.concatenate([before[at], digital * each.step + each.least])
                yield part, abs(each.step)
                before[at] = part[len(part) - overlap :] if len(part) > overlap else part


def texts_of_edf(path: Path) -> Iterator[bytes]:
    """Yield the header, and the annotations of each record.

    Raises
    ------
    ValueError
        If it is neither EDF nor BDF.
    """
    with path.open("rb") as file:
        layout = layout_of(file, path)
        file.seek(0)
        yield file.read(layout.head)
        while layout.record and (record := file.read(layout.record)):
            for begin, end in layout.spans:
                yield record[begin:end]


def write_edf_without(path: Path, target: Path, person: Person) -> None:
    """Copy it with a person's name replaced by a text of the same length.

    Raises
    ------
    OSError
        If it cannot be read or written.
    ValueError
        If it is neither EDF nor BDF.
    """
    with path.open("rb") as file, new_file(target, like=path) as new:
        layout = layout_of(file, path)
        file.seek(0)
        new.write(person.blanked(file.read(layout.head)))
        while layout.record and (record := file.read(layout.record)):
            masked = bytearray(record)
            for begin, end in layout.spans:
                masked[begin:end] = person.blanked(record[begin:end])
            new.write(masked)


def is_in_message(content: bytes, person: Person) -> bool:
    """Whether a text in a message of ROS names a person.

    In CDR, a text is preceded by its length in four bytes and followed by a zero byte.
    """
    for start, end in person.places(content):
        begin = content.rfind(b"\0", 0, start) + 1
        behind = content.find(b"\0", end)
        told = int.from_bytes(content[max(0, begin - 4) : begin], "little")
        if behind >= 0 and told == behind - begin + 1:
            return True
    return False
