"""Which libraries a Windows binary asks for, read without loading it.

Layout: Microsoft's PE Format, "Optional Header Data Directories" and "The .idata Section".
"""

from __future__ import annotations

import struct
from pathlib import Path

_PE32_PLUS, _IMPORTS = 0x20B, 1


def imported(binary: Path) -> set[str]:
    """Return their names in small letters; those that are loaded on demand are not among them."""
    data = binary.read_bytes()
    (header,) = struct.unpack_from("<I", data, 0x3C)
    (count,) = struct.unpack_from("<H", data, header + 6)
    (optional_size,) = struct.unpack_from("<H", data, header + 20)
    optional = header + 24
    if struct.unpack_from("<H", data, optional) != (_PE32_PLUS,):
        # Programs of 32 bit that come along are for others to start.
        return set()
    sections = [
        struct.unpack_from("<IIII", data, optional + optional_size + 40 * each + 8)
        for each in range(count)
    ]

    def offset(address: int) -> int:
        for size, begin, raw_size, raw in sections:
            if begin <= address < begin + max(size, raw_size):
                return address - begin + raw
        raise ValueError(f"{binary}: no section has {address:#x}")

    (directory,) = struct.unpack_from("<I", data, optional + 112 + 8 * _IMPORTS)
    names: set[str] = set()
    at = offset(directory) if directory else 0
    while at and (name := struct.unpack_from("<5I", data, at)[3]):
        start = offset(name)
        names.add(data[start : data.index(b"\0", start)].decode("ascii").lower())
        at += 20
    return names
