"""The sentences and the progress line of a replay."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from biosensor_gateway.recording.replay.player import Player, Progress
from biosensor_gateway.recording.xdf.container import Damage

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
    """Yield warnings about streams that are not played."""
    for each in player.left_out:
        yield (
            f"warning: {each.header.name} is not played, because {each.clock_error}; --streams "
            f"{each.header.name!r} plays it alone"
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


def _streams(count: int) -> str:
    return "1 stream" if count == 1 else f"{count} streams"
