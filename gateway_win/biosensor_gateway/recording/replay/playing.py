"""Gets a recording ready to be played, for the command and for the page."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from biosensor_gateway.recording.contents.choice import Wish, choose
from biosensor_gateway.recording.replay.live import refuse_if_present
from biosensor_gateway.recording.replay.player import Order, Player
from biosensor_gateway.recording.replay.source import content_hash, opened


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to play, and how; `may_be_beside`: although the real streams are here, too."""

    file: Path
    wish: Wish
    order: Order
    may_be_beside: bool


@contextmanager
def prepared(wanted: Wanted, allowed_by: str) -> Generator[Player]:
    """Open a recording, see that it may be played, and put its streams on the network.

    Parameters
    ----------
    allowed_by
        How to play although a real stream is there, for the sentence that refuses it.

    Yields
    ------
    Player
        To be run.

    Raises
    ------
    BagError, RecordingError
        If the file cannot be read.
    ConfigError
        If what is wanted is not in it.
    ReplayError
        If it is not played, see its reasons.
    """
    with opened(wanted.file) as contents:
        chosen = choose(contents, wanted.wish)
        player = Player(chosen, wanted.order, content_hash(contents.path))
        refuse_if_present(
            player.own_ids,
            player.recorded_ids,
            wanted.file.name,
            allowed_by=allowed_by,
            may_be_beside=wanted.may_be_beside,
        )
        player.offer()
        yield player
