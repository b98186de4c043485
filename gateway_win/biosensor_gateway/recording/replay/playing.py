"""Gets a recording ready to be played, for the command and for the page."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from biosensor_common.lsl.network import search
from biosensor_gateway.recording.contents.choice import Wish, choose
from biosensor_gateway.recording.replay.player import Order, Player
from biosensor_gateway.recording.replay.source import (
    ReplayError,
    ReplayReason,
    content_hash,
    opened,
)

SEARCH_S = 2.0
"""LSL asks the network several times in this time; one answer may get lost."""


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


def refuse_if_present(
    own: Iterable[str],
    recorded: Iterable[str],
    file: str,
    *,
    allowed_by: str,
    may_be_beside: bool,
) -> None:
    """Look for streams for some seconds.

    Parameters
    ----------
    own
        source_ids under which streams are to be played.
    recorded
        source_ids that the same streams had when they were measured.
    file
        What is to be played, for the sentence.
    allowed_by
        How to play although a real one is there, for the sentence.
    may_be_beside
        Whether the real streams may be there.

    Raises
    ------
    ReplayError
        ``LIVE``, if one of `recorded` is on the network; ``PLAYED``, if one of `own` is.
    """
    ids = {each: ReplayReason.PLAYED for each in own if each}
    if not may_be_beside:
        ids |= {each: ReplayReason.LIVE for each in recorded if each}
    found = search(
        lambda found, elapsed_s: (
            elapsed_s >= SEARCH_S or any(info.source_id() in ids for info in found.values())
        )
    )
    for info in found:
        reason = ids.get(info.source_id())
        if reason is not None:
            raise ReplayError(
                reason,
                _SENTENCES[reason].format(
                    file=file,
                    name=info.name(),
                    host=info.hostname() or "an unknown computer",
                    allowed_by=allowed_by,
                ),
            )


_SENTENCES: Mapping[ReplayReason, str] = {
    ReplayReason.LIVE: (
        "the real stream {name} is on the network, from {host}, and whoever receives it could "
        "take the replay of {file} for it; end it first, or {allowed_by}"
    ),
    ReplayReason.PLAYED: "{file} is being played already, by {host}; end that replay first",
}
