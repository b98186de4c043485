"""``biosensor-gateway replay``: plays a recording as LSL streams.

Functions import the player, which takes a second, so that the help is shown quickly.
"""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from biosensor_gateway.cli.options import (
    FromOption,
    ParticipantOption,
    RecordingArgument,
    SettingsOption,
    StreamsOption,
    UntilOption,
    WithoutOption,
    settings_or_defaults,
    wrong_recording,
)
from biosensor_gateway.cli.output import say
from biosensor_gateway.recording.replay import FASTEST, SLOWEST
from biosensor_gateway.settings.models import LslSettings

if TYPE_CHECKING:
    from biosensor_gateway.recording.replay.playback import Wanted
    from biosensor_gateway.recording.replay.player import Player

_SHOWN_PER_S = 2
_ALLOWED_BY = "add --beside-live"


def replay(
    file: RecordingArgument,
    speed: Annotated[
        float,
        typer.Option(min=SLOWEST, max=FASTEST, help="Speed: seconds of the recording per second."),
    ] = 1.0,
    begin: FromOption = "",
    end: UntilOption = "",
    streams: StreamsOption = None,
    participant: ParticipantOption = "",
    without: WithoutOption = "",
    loop: Annotated[
        bool, typer.Option("--loop", help="Start again at the end, until Ctrl-C.")
    ] = False,
    waits: Annotated[
        bool,
        typer.Option("--wait-for-consumers", help="Start when every stream has a receiver."),
    ] = False,
    as_original: Annotated[
        bool,
        typer.Option(
            "--as-original", help="Keep the recorded source_ids, for programs that look for them."
        ),
    ] = False,
    beside_live: Annotated[
        bool,
        typer.Option(
            "--beside-live", help="Play even if a real sensor sends one of the streams now."
        ),
    ] = False,
    settings: SettingsOption = None,
) -> None:
    """Play a recording as LSL streams, with the headers, gaps and times that were recorded.

    Samples get new stamps that keep the recorded intervals. Headers say that
    it is a replay, and source_ids begin with "replay:", so that nobody takes
    it for the real sensor. While the real sensor is on the network, nothing
    is played.
    """
    if as_original and beside_live:
        raise typer.BadParameter("--as-original and --beside-live exclude each other")
    from biosensor_gateway.recording.contents.choice import Selection
    from biosensor_gateway.recording.replay.playback import Wanted
    from biosensor_gateway.recording.replay.player import PlayOptions
    from biosensor_gateway.system.shutdown import until_signalled

    wanted = Wanted(
        file=file,
        selection=Selection(streams or (), begin, end, participant, without),
        options=PlayOptions(speed=speed, loop=loop, waits=waits, as_original=as_original),
        may_be_beside=beside_live,
    )
    lsl = settings_or_defaults(settings).lsl
    asyncio.run(until_signalled(lambda: play(wanted, lsl)))


async def play(wanted: Wanted, lsl: LslSettings) -> None:
    """Play to the end, or until cancelled.

    Raises
    ------
    ConfigError
        If the file cannot be read, or has none of the requested streams.
    ReplayError
        If the recording cannot be played; see its reasons.
    typer.Exit
        With code 1, at the end, if a stream or a sample was left out or could not be read.
    """
    from biosensor_common.lsl.network import configure_lsl

    configure_lsl(lsl.overrides)
    stopping = threading.Event()
    work = asyncio.get_running_loop().run_in_executor(None, _play, wanted, lsl, stopping)
    try:
        if not await asyncio.shield(work):
            raise typer.Exit(1)
    except asyncio.CancelledError:
        stopping.set()
        await work
        raise


def _play(wanted: Wanted, lsl: LslSettings, stopping: threading.Event) -> bool:
    """Play; return whether all requested streams were played."""
    from biosensor_gateway.recording.replay import playback
    from biosensor_gateway.recording.replay.playback import prepared

    with wrong_recording(), prepared(wanted, _ALLOWED_BY) as player:
        for sentence in (
            *playback.elsewhere(lsl.overrides),
            *playback.damaged(player.damages),
            *playback.left_out(player),
        ):
            say(sentence)
        if not stopping.is_set():
            say(playback.begun(wanted.file.name, player, wanted.options.speed))
            with _shown(player):
                player.run(stopping)
        for sentence in playback.ended(player, was_stopped=stopping.is_set()):
            say(sentence)
        return player.is_whole


@contextmanager
def _shown(player: Player) -> Generator[None]:
    """On a terminal, show the progress in a line that is removed at the end."""
    if not sys.stdout.isatty():
        yield
        return
    from biosensor_gateway.recording.replay import playback

    def line() -> Text:
        text = playback.line(player.progress(), len(player.streams))
        return Text(text, no_wrap=True, overflow="ellipsis")

    # `Live` draws on its own thread, so that a blocked console does not delay samples.
    with Live(
        console=Console(), get_renderable=line, refresh_per_second=_SHOWN_PER_S, transient=True
    ):
        yield
