"""Plays a recording and says how it goes."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager

import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from biosensor_common.lsl.network import configure_lsl
from biosensor_gateway.cli.recordings import wrong_recording
from biosensor_gateway.cli.screen import say
from biosensor_gateway.recording.replay import words
from biosensor_gateway.recording.replay.player import Player
from biosensor_gateway.recording.replay.playing import Wanted, prepared
from biosensor_gateway.settings.models import LslSettings

_SHOWN_PER_S = 2
_ALLOWED_BY = "add --beside-live"


async def play(wanted: Wanted, lsl: LslSettings) -> None:
    """Play to the end, or until cancelled.

    Raises
    ------
    ConfigError
        If the file cannot be read, or what is wanted is not in it.
    ReplayError
        If it is not played, see its reasons.
    typer.Exit
        With code 1, after all, if a stream was left out.
    """
    configure_lsl(lsl.overrides)
    stopping = threading.Event()
    work = asyncio.get_running_loop().run_in_executor(None, _play, wanted, stopping)
    try:
        if not await asyncio.shield(work):
            raise typer.Exit(1)
    except asyncio.CancelledError:
        stopping.set()
        await work
        raise


def _play(wanted: Wanted, stopping: threading.Event) -> bool:
    """Play; return whether all streams that were wanted were."""
    with wrong_recording(), prepared(wanted, _ALLOWED_BY) as player:
        for sentence in (*words.damaged(player.damages), *words.left_out(player)):
            say(sentence)
        if not stopping.is_set():
            say(words.begun(wanted.file.name, player, wanted.order.speed))
            with _shown(player):
                player.run(stopping)
        for sentence in words.ended(player, was_stopped=stopping.is_set()):
            say(sentence)
        return not player.left_out


@contextmanager
def _shown(player: Player) -> Generator[None]:
    """Show how it goes, in a line that goes away at the end; only on a terminal."""
    if not sys.stdout.isatty():
        yield
        return

    def line() -> Text:
        text = words.line(player.progress(), len(player.streams))
        return Text(text, no_wrap=True, overflow="ellipsis")

    # Drawn by a thread of its own, so that a console that is held keeps no sample.
    with Live(
        console=Console(), get_renderable=line, refresh_per_second=_SHOWN_PER_S, transient=True
    ):
        yield
