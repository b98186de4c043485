"""Prepares a replay, for the command and for the page."""

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
"""LSL sends several queries in this time, because an answer may get lost."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to play and how; `may_be_beside` allows it while the real streams are visible."""

    file: Path
    wish: Wish
    order: Order
    may_be_beside: bool


@contextmanager
def prepared(wanted: Wanted, allowed_by: str) -> Generator[Player]:
    """Open a recording, check that it may be replayed, and offer its streams.

    Parameters
    ----------
    allowed_by
        For the error message: how to allow a replay while a real stream is visible.

    Yields
    ------
    Player
        Ready to run.

    Raises
    ------
    BagError, RecordingError
        If the file cannot be read.
    ConfigError
        If the selection is not in it.
    ReplayError
        If it cannot be replayed; see its reasons.
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
    """Search for some seconds for streams that forbid a replay.

    Parameters
    ----------
    own
        source_ids of the streams to play.
    recorded
        source_ids of the same streams when they were recorded.
    file
        For the error message: the recording.
    allowed_by
        For the error message: how to allow a replay while a real stream is visible.
    may_be_beside
        Whether the real streams may be visible.

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
