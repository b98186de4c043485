"""Reads the names of what PyInstaller put into a frozen program.

Such a program ends with an archive, which holds scripts, a few modules and one more archive
(PYZ) with all other modules. The formats are those of ``PyInstaller/archive/readers.py`` and
``PyInstaller/loader/pyimod01_archive.py`` of PyInstaller 6; read here because the checks also
run where PyInstaller is not installed.
"""

from __future__ import annotations

import marshal
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from installer.bundle.errors import ArchiveError

_COOKIE_MAGIC = b"MEI\x0c\x0b\x0a\x0b\x0e"
_COOKIE = struct.Struct("!8sIIII64s")
_ENTRY = struct.Struct("!IIIIBc")
_PYZ_MAGIC = b"PYZ\0"
_PYZ_NAMESPACE = 3
_PYZ_HEADER = struct.Struct("!4s4si")
_KNOWN_KINDS = b"bdzZMmsxol"


@dataclass(frozen=True, slots=True)
class Archive:
    """What a frozen program holds."""

    # Names of the scripts that it runs one after the other, without `.py`.
    scripts: tuple[str, ...]
    # Dotted names of its modules and packages; none of namespace packages, which are no files.
    modules: tuple[str, ...]


def read_archive(program: Path) -> Archive:
    """Read the names in a frozen program.

    Raises
    ------
    ArchiveError
        If it is not such a program, or has more than the program of a folder bundle.
    """
    data = program.read_bytes()
    scripts: list[str] = []
    modules: list[str] = []
    try:
        start, entries = _entries(data)
        for name, kind, offset in entries:
            if kind == b"s":
                scripts.append(name)
            elif kind in {b"m", b"M"}:
                modules.append(name)
            elif kind == b"z":
                modules.extend(_pyz_modules(data, start + offset))
            elif kind != b"o":
                message = f"{program.name} holds {name!r}, which is neither script nor module."
                raise ArchiveError(message)
    except (struct.error, ValueError, EOFError, TypeError, IndexError) as error:
        message = f"{program.name} is no program frozen by PyInstaller 6 ({error})."
        raise ArchiveError(message) from error
    return Archive(tuple(scripts), tuple(modules))


def _entries(data: bytes) -> tuple[int, Iterator[tuple[str, bytes, int]]]:
    cookie = data.rindex(_COOKIE_MAGIC)
    _, length, toc, toc_length, _, _ = _COOKIE.unpack_from(data, cookie)
    start = cookie + _COOKIE.size - length
    if start < 0 or start + toc + toc_length > len(data):
        raise ValueError("its archive is cut off")
    return start, _toc(data[start + toc : start + toc + toc_length])


def _toc(toc: bytes) -> Iterator[tuple[str, bytes, int]]:
    position = 0
    while position < len(toc):
        size, offset, _, _, _, kind = _ENTRY.unpack_from(toc, position)
        if size <= _ENTRY.size or kind not in _KNOWN_KINDS:
            raise ValueError("its table of contents is damaged")
        name = toc[position + _ENTRY.size : position + size].rstrip(b"\0").decode("utf-8")
        yield name, kind, offset
        position += size


def _pyz_modules(data: bytes, start: int) -> Iterator[str]:
    magic, _, offset = _PYZ_HEADER.unpack_from(data, start)
    if magic != _PYZ_MAGIC:
        raise ValueError("its archive of modules is damaged")
    # The table alone, which is plain tuples; no code is loaded.
    table = cast(
        "list[tuple[str, tuple[int, int, int]]]",
        marshal.loads(data[start + offset :]),  # noqa: S302
    )
    return (name for name, (kind, _, _) in table if kind != _PYZ_NAMESPACE)
