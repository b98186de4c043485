"""Writes a DLL without code, whose functions are those of another DLL.

Layout: Microsoft's PE Format, "The .edata Section": an export whose address lies
inside the export section is a forwarder, the name ``dll.function``.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

_SECTION_RVA = 0x1000
_FILE_ALIGNMENT = 0x200
_AMD64 = 0x8664
_EXECUTABLE, _LARGE_ADDRESS, _DLL = 0x0002, 0x0020, 0x2000
_PE32_PLUS = 0x20B
_CONSOLE = 3
_INITIALIZED_DATA, _READ = 0x40, 0x40000000


def forwarding_dll(name: str, exports: Mapping[str, str]) -> bytes:
    """Write the file.

    Parameters
    ----------
    name
        Of the DLL itself.
    exports
        What each function really is, as ``advapi32.SystemFunction036``.
    """
    section = _export_section(name, exports)
    padded = section.ljust(-(-len(section) // _FILE_ALIGNMENT) * _FILE_ALIGNMENT, b"\0")
    headers = _headers(len(section), len(padded))
    return headers.ljust(_FILE_ALIGNMENT, b"\0") + padded


def _export_section(name: str, exports: Mapping[str, str]) -> bytes:
    names = sorted(exports)
    count = len(names)
    tables = 40  # of the directory itself
    addresses, pointers = tables, tables + 4 * count
    ordinals = pointers + 4 * count
    strings = bytearray()
    base = _SECTION_RVA + ordinals + 2 * count

    def text(value: str) -> int:
        at = base + len(strings)
        strings.extend(value.encode("ascii") + b"\0")
        return at

    own = text(name)
    forwarders = [text(exports[each]) for each in names]
    labels = [text(each) for each in names]
    directory = struct.pack(
        "<IIHHIIIIIII",
        *(0, 0, 0, 0, own, 1, count, count),
        *(_SECTION_RVA + addresses, _SECTION_RVA + pointers, _SECTION_RVA + ordinals),
    )
    table = struct.pack(f"<{count}I{count}I{count}H", *forwarders, *labels, *range(count))
    return directory + table + bytes(strings)


def _headers(size: int, size_on_disk: int) -> bytes:
    dos = b"MZ".ljust(60, b"\0") + struct.pack("<I", 64)
    characteristics = _EXECUTABLE | _LARGE_ADDRESS | _DLL
    coff = b"PE\0\0" + struct.pack("<HHIIIHH", _AMD64, 1, 0, 0, 0, 240, characteristics)
    image = _SECTION_RVA + -(-size // 0x1000) * 0x1000
    optional = struct.pack(
        "<HBBIIIIIQIIHHHHHHIIIIHHQQQQII",
        *(_PE32_PLUS, 14, 0, 0, size_on_disk, 0, 0, 0),
        *(0x180000000, 0x1000, _FILE_ALIGNMENT, 6, 0, 0, 0, 6, 0, 0),
        *(image, _FILE_ALIGNMENT, 0, _CONSOLE, 0),
        *(0x100000, 0x1000, 0x100000, 0x1000, 0, 16),
    )
    directories = struct.pack("<II", _SECTION_RVA, size).ljust(16 * 8, b"\0")
    section = b".edata\0\0" + struct.pack(
        "<IIIIIIHHI",
        *(size, _SECTION_RVA, size_on_disk, _FILE_ALIGNMENT, 0, 0, 0, 0),
        _INITIALIZED_DATA | _READ,
    )
    return dos + coff + optional + directories + section
