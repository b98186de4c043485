"""Keeps what comes before anybody can use it."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

_T = TypeVar("_T")


class Early(Generic[_T]):
    """What came early, in order, until it is taken.

    A device talks while its driver still asks who it is, or before its clock is known; what it
    has measured by then is not to be lost.

    Parameters
    ----------
    most
        So many are kept.
    is_newest_kept
        Whether the oldest makes room where more come; else those are passed over, so that
        nothing is missing between what is kept.
    """

    def __init__(self, most: int, *, is_newest_kept: bool = False) -> None:
        self._most, self._is_newest_kept = most, is_newest_kept
        self._kept: deque[_T] = deque(maxlen=most)

    def __bool__(self) -> bool:
        """Whether anything is kept."""
        return bool(self._kept)

    def keep(self, *came: _T) -> None:
        """Keep what came, as far as there is room."""
        room = len(came) if self._is_newest_kept else self._most - len(self._kept)
        self._kept.extend(came[:room])

    def take(self) -> list[_T]:
        """Return what is kept, the oldest first, and keep it no longer."""
        taken = list(self._kept)
        self._kept.clear()
        return taken
