"""Keeps the newest of all streams, for the browsers that show some of them."""

from __future__ import annotations

from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.page.history import KEPT_S, History
from biosensor_gateway.page.screen import Screen


class Traces:
    """Keeps samples, and gives them to the browsers; on the loop of the server alone.

    Parameters
    ----------
    kept_s
        For how long samples are kept.

    Attributes
    ----------
    screens
        One a browser.
    opened
        How many there have been.
    """

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self.history = History(kept_s)
        self.screens: set[Screen] = set()
        self.opened = 0

    def take(self, samples: Samples) -> None:
        """Keep what came, and give it to the browsers that show it."""
        self.history.add(samples)
        for screen in self.screens:
            screen.add(samples)

    def open(self) -> Screen:
        """Add a browser."""
        screen = Screen(self.history)
        self.screens.add(screen)
        self.opened += 1
        return screen

    def close(self, screen: Screen) -> None:
        """Forget a browser."""
        self.screens.discard(screen)

    @property
    def wanted(self) -> frozenset[str]:
        """The streams that some browser shows."""
        return frozenset[str]().union(*(screen.streams for screen in self.screens))
