"""Reading shortcuts, the entries of a Start menu, after Microsoft's [MS-SHLLINK] 8.0."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from uuid import UUID

_HEADER = struct.Struct("<I16sI")
_HEADER_SIZE = 0x4C
_CLASS = UUID("00021401-0000-0000-c000-000000000046")

_HAS_ID_LIST, _HAS_LINK_INFO, _IS_UNICODE = 0x01, 0x02, 0x80
# In the order in which they follow each other (section 2.4).
_STRINGS = {
    "name": 0x04,
    "relative_path": 0x08,
    "working_folder": 0x10,
    "arguments": 0x20,
    "icon": 0x40,
}

# LinkInfo (section 2.3): its size, that of its header, flags, four offsets.
_LINK_INFO = struct.Struct("<7I")
_VOLUME_AND_LOCAL_BASE_PATH = 0x01


class ShortcutError(ValueError):
    """Bytes that are no shortcut to a local file."""


@dataclass(frozen=True, slots=True)
class Shortcut:
    """What a shortcut opens.

    Attributes
    ----------
    target
        The program, in the code page of the PC; empty if it is only told as an ID list.
    arguments, working_folder, icon
        As they are written; empty where absent.
    """

    target: str
    arguments: str = ""
    working_folder: str = ""
    icon: str = ""


def read_shortcut(path: Path) -> Shortcut:
    """Read a ``.lnk`` file.

    Raises
    ------
    ShortcutError
        It is none.
    """
    content = path.read_bytes()
    try:
        return _shortcut(content)
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise ShortcutError(f"{path}: cut off or damaged: {error}") from error


def _shortcut(content: bytes) -> Shortcut:
    size, class_id, flags = _HEADER.unpack_from(content)
    if size != _HEADER_SIZE or UUID(bytes_le=class_id) != _CLASS:
        raise ShortcutError("the file has no shortcut's header")
    position, target = _HEADER_SIZE, ""
    if flags & _HAS_ID_LIST:
        position += 2 + _uint16(content, position)
    if flags & _HAS_LINK_INFO:
        info_size, target = _local_target(content[position:])
        position += info_size
    strings: dict[str, str] = {}
    for name, flag in _STRINGS.items():
        if flags & flag:
            strings[name], position = _string(content, position, wide=bool(flags & _IS_UNICODE))
    return Shortcut(
        target,
        strings.get("arguments", ""),
        strings.get("working_folder", ""),
        strings.get("icon", ""),
    )


def _local_target(info: bytes) -> tuple[int, str]:
    """Return the size of a LinkInfo and the path in it."""
    size, _, flags, _, base, _, suffix = _LINK_INFO.unpack_from(info)
    if not flags & _VOLUME_AND_LOCAL_BASE_PATH:
        return size, ""
    return size, _terminated(info, base) + _terminated(info, suffix)


def _terminated(content: bytes, start: int) -> str:
    # The code page is that of the PC, which is not told.
    return content[start : content.index(0, start)].decode("cp1252")


def _string(content: bytes, position: int, *, wide: bool) -> tuple[str, int]:
    """Return a counted string and where the next one begins."""
    start = position + 2
    end = start + _uint16(content, position) * (2 if wide else 1)
    if end > len(content):
        raise IndexError("a string ends after the file")
    text = content[start:end].decode("utf-16-le" if wide else "cp1252")
    # Wine counts and writes an end that the format does not have.
    return text.removesuffix("\0"), end


def _uint16(content: bytes, position: int) -> int:
    (value,) = struct.unpack_from("<H", content, position)
    return int(value)
