"""Counts the messages that were published and did not arrive."""

from __future__ import annotations


class PublicationLosses:
    """Follows the numbers that a publisher gives its messages.

    They are of one publisher, and a message does not say whose it is: with two publishers on
    a topic nothing can be known. What is missing therefore counts only at the next look, if
    there was one publisher then, too.
    """

    def __init__(self) -> None:
        self._newest: int | None = None
        self._missing = 0
        self._lost = 0
        self._is_unknown = False

    @property
    def lost(self) -> int | None:
        """How many, since the first message; None if nobody can know."""
        return None if self._is_unknown else self._lost

    def take(self, number: int | None) -> None:
        """Take in the number of a message; None if the middleware gives none."""
        if number is None:
            self._is_unknown = True
            return  # nothing is dropped: this counts only
        # A smaller one is of a publisher that was started anew.
        if self._newest is not None and number > self._newest + 1:
            self._missing += number - self._newest - 1
        self._newest = number

    def look(self, publishers: int) -> int:
        """Take in how many publishers there are; return how many messages are newly missing."""
        if publishers > 1:
            self._is_unknown = True
        new, self._missing = self._missing, 0
        if self._is_unknown:
            return 0
        self._lost += new
        return new
