"""Reads what a Windows binary says about itself, without loading it."""

from __future__ import annotations

import re
import struct

# VS_FIXEDFILEINFO: its signature, its own version, then the file's version as two words.
_FIXED_FILE_INFO = struct.Struct("<IIII")
_SIGNATURE = struct.pack("<I", 0xFEEF04BD)

# Wine stamps its own libraries here, behind the DOS header.
_WINE_MARKS = (b"Wine builtin DLL", b"Wine placeholder DLL")
_DOS_HEADER = 0x40


def is_wines(data: bytes) -> bool:
    """Tell whether a binary is one of Wine's."""
    return data[_DOS_HEADER:].startswith(_WINE_MARKS)


def is_microsofts(data: bytes) -> bool:
    """Tell whether a binary names Microsoft as its company."""
    return "CompanyName\0\0Microsoft Corporation\0".encode("utf-16-le") in data


def file_version(data: bytes) -> str | None:
    """Return the version of the version resource as ``1.2.3.4``; None if it has none."""
    at = data.find(_SIGNATURE)
    if at < 0:
        return None
    _, _, high, low = _FIXED_FILE_INFO.unpack_from(data, at)
    return ".".join(str(word) for word in (high >> 16, high & 0xFFFF, low >> 16, low & 0xFFFF))


def version_by(pattern: re.Pattern[bytes] | None, data: bytes) -> str | None:
    """Return the version that a pattern's first group finds, in text of one or two bytes."""
    if pattern is None:
        return None
    found = pattern.search(data) or pattern.search(data.replace(b"\0", b""))
    return found[1].decode("ascii") if found else None
