"""Looks whether the real streams are on the network."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping

import pylsl

from biosensor_gateway.recording.replay.errors import ReplayError, ReplayReason

SEARCH_S = 2.0
"""LSL asks the network several times in this time; one answer may get lost."""
_LOOK_S = 0.1


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
    resolver = pylsl.ContinuousResolver(forget_after=2 * SEARCH_S)
    until_s = time.monotonic() + SEARCH_S
    while time.monotonic() < until_s:
        time.sleep(_LOOK_S)
        for info in resolver.results():
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
