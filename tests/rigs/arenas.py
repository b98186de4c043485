"""Counts the arenas of glibc's malloc that a process has, from outside."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

# Where one begins, glibc's arena.c has memory of this size and alignment (64-bit systems).
_HEAP_BYTES = 64 * 1024 * 1024


def count_arenas(pid: int) -> int:
    """Return how many arenas a process has, the main one included.

    An arena that has outgrown 64 MB counts again for each further 64 MB.
    """
    maps = [line.split() for line in Path(f"/proc/{pid}/maps").read_text().splitlines()]
    # What is not used yet of a heap follows it, without any permission.
    return 1 + sum(_is_heap(used, unused) for used, unused in pairwise(maps))


def _is_heap(used: list[str], unused: list[str]) -> bool:
    if used[1] != "rw-p" or unused[1] != "---p" or len(used) > 5 or len(unused) > 5:
        return False
    begin, end = (int(part, 16) for part in used[0].split("-"))
    next_begin, next_end = (int(part, 16) for part in unused[0].split("-"))
    is_whole = end == next_begin and next_end - begin == _HEAP_BYTES
    return is_whole and begin % _HEAP_BYTES == 0
