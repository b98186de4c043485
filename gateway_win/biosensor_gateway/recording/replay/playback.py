"""Prepares the replay of a recording for the command and the page, and words its progress."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from biosensor_common.errors import ConfigError
from biosensor_common.lsl import api_file
from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.lsl.network import search
from biosensor_gateway.agent import status_file
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.replay.player import Player, PlayOptions, Progress
from biosensor_gateway.recording.replay.source import (
    ReplayError,
    ReplayReason,
    content_hash,
    opened,
)
from biosensor_gateway.recording.replay.stream_outlet import NAMELESS
from biosensor_gateway.recording.xdf.container import Damage
from biosensor_gateway.recording.xdf.pace import stray_text
from biosensor_gateway.recording.xdf.recording import repeated_text
from biosensor_gateway.settings.places import state_folder

SEARCH_S = 2.0
"""LSL sends several queries in this time, because an answer may get lost."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to play and how; `may_be_beside` allows it while the real streams are visible."""

    file: Path
    selection: Selection
    options: PlayOptions
    may_be_beside: bool


def elsewhere(lsl: LslOverrides) -> Iterator[str]:
    """Yield a sentence if the agent of this computer is in another LSL session than the replay."""
    try:
        status = status_file.read_status(state_folder())
    except ConfigError:
        return
    if status_file.other_session(status, lsl):
        yield (
            f"it is played in the LSL session {api_file.session(api_file.config_here(lsl))} of "
            f"the settings, but the agent sends in {status['session']}: programs in that session "
            "do not receive it"
        )


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
        chosen = choose(contents, wanted.selection)
        player = Player(chosen, wanted.options, content_hash(contents.path))
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
        "the real stream {name} is on the network, from {host}, and its receivers could mistake "
        "the replay of {file} for it; end it first, or {allowed_by}"
    ),
    ReplayReason.PLAYED: "{file} is already being played, by {host}; end that replay first",
}
_MOST_DAMAGES = 3


def span(seconds: float) -> str:
    """Return a time in a recording as ``h:mm:ss``, which options accept, too."""
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


def damaged(damages: Sequence[Damage]) -> Iterator[str]:
    """Yield warnings about parts of the recording that cannot be played."""
    for each in damages[:_MOST_DAMAGES]:
        yield (
            f"warning: bytes {each.start} to {each.end} of the recording cannot be read "
            f"({each.what}); the rest is played"
        )
    if len(damages) > _MOST_DAMAGES:
        yield f"warning: {len(damages) - _MOST_DAMAGES} more places cannot be read"


def left_out(player: Player) -> Iterator[str]:
    """Yield warnings about streams and samples that are not played, or not as recorded."""
    for each in player.streams:
        name = each.header.title
        if each.untimed:
            samples = "1 sample is" if each.untimed == 1 else f"{each.untimed} samples are"
            yield f"warning: {name}: {samples} not played, because their stamps are not numbers"
        if each.repeated:
            yield f"warning: {name}: {repeated_text(each.repeated)}"
        if each.part_error:
            yield f"warning: {name}: {each.part_error}; those samples are not played"
        elif each.stray:
            yield f"warning: {name}: {stray_text(len(each.stray))}; sent between their neighbours"
        if each.steps_far_back and not each.part_error:
            yield (
                f"warning: {name}: its time steps back {_times(each.steps_far_back)}; the "
                "following samples are sent immediately, until the earlier time is reached "
                "again"
            )
        if not name:
            yield f"warning: a stream without a name is played as {NAMELESS!r}"
    for each in player.left_out:
        yield (
            f"warning: {each.header.title} is not played, because {each.clock_error}; --streams "
            f"{each.header.title!r} plays it alone"
        )


def begun(file: str, player: Player, speed: float) -> str:
    """Return the sentence for the start."""
    progress = player.progress()
    how = "" if speed == 1 else f" at {speed:g} times its speed"
    return (
        f"{file}: {_streams(len(player.streams))}, {span(progress.length_s)}{how}; "
        "press Ctrl-C to end it."
    )


def line(progress: Progress, streams: int) -> str:
    """Return the progress line."""
    received = f"{progress.received} of {_streams(streams)} received"
    if not progress.lap:
        return f"waiting for receivers: {received}"
    lap = f"round {progress.lap}, " if progress.lap > 1 else ""
    place = f"{span(progress.position_s)} of {span(progress.length_s)}"
    return f"{lap}{place}, {progress.sent} samples, {received}"


def ended(player: Player, *, was_stopped: bool) -> Iterator[str]:
    """Yield sentences about what was played, and how punctually."""
    progress, late = player.progress(), player.lateness
    if was_stopped:
        rounds = f" of round {progress.lap}" if progress.lap > 1 else ""
        yield f"Ended at {span(progress.position_s)} of {span(progress.length_s)}{rounds}."
    if not progress.sent:
        yield "Nothing was sent."
        return
    median, most = (1e3 * late.percentile_s(percent) for percent in (50, 99))
    yield (
        f"{progress.sent} samples were sent: half of them within {median:.1f} ms of their time, "
        f"99 % within {most:.1f} ms, all within {1e3 * late.most_s:.1f} ms."
    )


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _streams(count: int) -> str:
    return "1 stream" if count == 1 else f"{count} streams"
